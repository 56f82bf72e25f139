#!/bin/sh
# Stands in for COLMAP: prints what version 3.8 or 4 prints, and copies models that exist already. The test sets FAKE (what happens),
# FAKE_MODELS (folder of models, 0, 1, ...) and FAKE_LOG (file of calls).
PATH=/usr/bin:/bin
echo "$*" >>"$FAKE_LOG"
command="$1"
last="$2"
while [ $# -gt 0 ]; do
  case "$1" in
  --database_path) database="$2" ;;
  --image_path) images="$2" ;;
  --image_list_path) list="$2" ;;
  --output_path) output="$2" ;;
  --vocab_tree_path) vocabulary="$2" ;;
  --VocabTreeMatching.vocab_tree_path) looked_up="$2" ;;
  esac
  shift
done
case "$FAKE" in
version4*) four=1 feature=FeatureExtraction match=FeatureMatching ;;
*) four= feature=SiftExtraction match=SiftMatching ;;
esac
# Version 4 logs to standard error with a time and a place.
say() {
  if [ "$four" ]; then echo "I20260315 10:00:00.000001 77 a.cc:300] $1" >&2; else echo "$1"; fi
}
if [ "$command" = help ]; then
  if [ "$FAKE" = stranger ]; then
    echo "column: a program of another kind"
    exit
  fi
  if [ "$four" ]; then version=4.1.0 more="  global_mapper"; else version=3.8 more=; fi
  cat <<END
COLMAP $version -- Structure-from-Motion and Multi-View Stereo
              (Commit Unknown on Unknown without CUDA)

Usage:
  colmap [command] [options]

Available commands:
  help
  exhaustive_matcher
  feature_extractor
$more
  mapper
  sequential_matcher
  vocab_tree_builder
  vocab_tree_matcher
END
  exit
fi
if [ "$last" = -h ]; then
  cat <<END
Options can either be specified via command-line or by defining
them in a .ini project file passed to \`--project_path\`.

  -h [ --help ]
  --database_path arg
  --$feature.use_gpu arg (=1)
  --$feature.max_image_size arg (=3200)
  --SiftExtraction.max_num_features arg (=8192)
  --SiftExtraction.first_octave arg (=-1)
  --num_visual_words arg (=65536)
  --$match.use_gpu arg (=1)
  --ExhaustiveMatching.block_size arg (=50)
END
  exit
fi
case "$command" in
feature_extractor)
  if [ "$FAKE" = killed ]; then kill -9 $$; fi
  if [ "$FAKE" = crash ]; then
    echo "*** Aborted at 1700000000 ***" >&2
    kill -SEGV $$
  fi
  printf 'SQLite format 3\000' >"$database"
  count=1250
  if [ "$FAKE" = bare ]; then count=3; fi
  i=0
  while read -r name; do
    i=$((i + 1))
    [ -e "$images/$name" ] || exit 3
    say "Processed file [$i/8]"
    say "  Name:            $name"
    say "  Features:        $count"
  done <"$list"
  ;;
vocab_tree_builder) cp "$database" "$vocabulary" ;;
exhaustive_matcher | sequential_matcher | vocab_tree_matcher)
  [ -e "$database" ] || exit 3
  [ "$command" != vocab_tree_matcher ] || [ -e "$looked_up" ] || exit 3
  say "Matching block [1/1, 1/1] in 0.013s"
  if [ "$FAKE" = full ]; then
    echo "ERROR: database or disk is full" >&2
    exit 1
  fi
  ;;
mapper | global_mapper)
  if [ "$FAKE" = slow ]; then
    say "Registering image #1 (3)"
    sleep 60
  fi
  case "$FAKE" in bare | apart)
    echo "WARNING: No images with matches found in the database."
    exit 1
    ;;
  esac
  if [ "$FAKE" = version4-poor ] && [ "$command" = global_mapper ]; then
    cp -r "$FAKE_MODELS/1" "$output/0"
    exit
  fi
  say "Registering image #7 (8)"
  cp -r "$FAKE_MODELS"/* "$output"
  ;;
*)
  echo "ERROR: Command \`$command\` not recognized."
  exit 1
  ;;
esac
