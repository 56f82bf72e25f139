#!/usr/bin/env bash
# Measures a graphics card: `benches/card.sh pack` compiles and packs what is needed into card.tar.xz, at most 60 MB, and
# `benches/card.sh run [OPTIONS]` runs it on any Linux machine with an adapter, without a compiler and in at most nine minutes.
# It leaves out/card.md and out/card.json. Options are those of `gpu card --help`.
set -euo pipefail
cd "$(dirname "$0")/.."
pack=benches/card.tar.xz
limit=60000000

# Prints the path of the newest executable that cargo built for a target, from its messages on standard input.
executable() { sed -n 's/.*"name":"'"$1"'".*"executable":"\([^"]*\)".*/\1/p' | tail -1; }

build() {
  local folder="$1" messages
  messages="$(mktemp)"
  # With the feature `vulkan`, `gpu` takes SPIR-V as `vulkan` does where the driver can, and WGSL elsewhere.
  local options=(--locked --release -p splat-op -p splat-tests -p splat-benches --features splat-benches/vulkan,splat-tests/vulkan --no-run --message-format=json)
  cargo test "${options[@]}" --bench gpu --test reference >"$messages"
  executable gpu <"$messages" | xargs -I{} cp {} "$folder/gpu"
  executable reference <"$messages" | xargs -I{} cp {} "$folder/reference_test"
  cargo test "${options[@]}" --lib >"$messages"
  executable splat_op <"$messages" | xargs -I{} cp {} "$folder/kernels"
  rm "$messages"
  strip "$folder"/{gpu,kernels,reference_test}
  mkdir "$folder/reference"
  cp tests/reference/*.safetensors "$folder/reference"
  git rev-parse --short HEAD >"$folder/commit"
}

case "${1:-}" in
pack)
  folder="$(mktemp -d)"
  trap 'rm -rf "$folder"' EXIT
  build "$folder"
  # The binaries have most of their code in common: a large dictionary finds it again.
  tar -C "$folder" -c . | xz --lzma2=preset=6,dict=512MiB >"$pack"
  size=$(stat -c %s "$pack")
  echo "$pack: $size bytes"
  if [ "$size" -gt "$limit" ]; then
    echo "the pack has more than $limit bytes" >&2
    exit 1
  fi
  ;;
run)
  shift
  if [ ! -f "$pack" ]; then
    echo "$pack is missing: run \`benches/card.sh pack\` where the sources can be compiled" >&2
    exit 1
  fi
  folder="$(mktemp -d)"
  trap 'rm -rf "$folder"' EXIT
  # A bare machine may have Python and no xz.
  if command -v xz >/dev/null; then xz -dc "$pack" | tar -C "$folder" -x; else
    python3 -c 'import sys, tarfile; tarfile.open(sys.argv[1]).extractall(sys.argv[2])' "$pack" "$folder"
  fi
  "$folder/gpu" card --tests "$folder" --commit "$(cat "$folder/commit")" "$@"
  ;;
*)
  echo "usage: benches/card.sh pack | benches/card.sh run [OPTIONS]" >&2
  exit 2
  ;;
esac
