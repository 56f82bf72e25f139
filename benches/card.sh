#!/usr/bin/env bash
# Measures a graphics card: `benches/card.sh pack` compiles and packs what is needed into card.tar.xz, at most 60 MB, and
# `benches/card.sh run [OPTIONS]` runs it on any Linux machine with an adapter, without a compiler and in at most nine minutes.
# It leaves out/card.md and out/card.json. Options are those of `gpu card --help`.
# `benches/card.sh gsplat [CAPTURE...]` then measures gsplat on the same scenes and captures and prints ratios. It needs the machine's nvcc,
# PyTorch, NumPy and Pillow.
set -euo pipefail
cd "$(dirname "$0")/.."
pack=benches/card.tar.xz
limit=60000000
# gsplat compiles its CUDA code where it runs; the others are what it imports.
wheels=(gsplat==1.5.3 ninja==1.13.2 jaxtyping==0.3.11 wadler-lindig==0.1.8 rich==15.0.0 markdown-it-py==4.3.0 mdurl==0.1.2 pygments==2.21.0)

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
  python3 -m pip download --quiet --no-deps --dest "$folder/wheels" "${wheels[@]}"
  cp benches/gsplat.py "$folder"
}

# Unpacks into `folder`, which goes when the script ends.
unpack() {
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
  unpack
  "$folder/gpu" card --tests "$folder" --commit "$(cat "$folder/commit")" "$@"
  ;;
gsplat)
  shift
  unpack
  python3 -m pip install --quiet --no-index --no-deps --target "$folder/site" "$folder"/wheels/*.whl
  "$folder/gpu" export "$folder/jobs" wide large huge "$@"
  card=()
  if [ -f out/card.json ]; then card=(--card out/card.json); fi
  PATH="$folder/site/bin:$PATH" PYTHONPATH="$folder/site" python3 "$folder/gsplat.py" "$folder/jobs" "${card[@]}"
  ;;
*)
  echo "usage: benches/card.sh pack | run [OPTIONS] | gsplat [CAPTURE...]" >&2
  exit 2
  ;;
esac
