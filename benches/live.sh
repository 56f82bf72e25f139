#!/usr/bin/env bash
# Measures what a page that looks at a run costs it: trains a capture in turns without `--live` and with it, asking as the page does, and
# prints the ratio of the training times of each pair, and the median.
#
#   benches/live.sh CAPTURE [PAIRS]
#
# Variables: STEPS (1000), SPLAT (the program; built if not named).
set -euo pipefail
cd "$(dirname "$0")/.."
if [ ! -d "${1:-}" ]; then
  echo "no capture folder: benches/live.sh CAPTURE [PAIRS]" >&2
  exit 2
fi
capture="$1"
splat="${SPLAT:-}"
if [ -z "$splat" ]; then
  # Without `-p`, so that Burn is compiled once for this and the tests.
  cargo build --locked --release
  splat="${CARGO_TARGET_DIR:-target}/release/splat"
fi
work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT

# Asks for the numbers every second, and for the scene and the worst view when there are new ones, until the server is gone.
look() {
  local url="" scene="" status new
  until url="$(grep -o 'http://127[^ ]*[0-9]' "$work/log")"; do sleep 0.05; done
  while status="$(curl -sf "$url/status.json")"; do
    new="$(grep -o '"scene":[0-9]*' <<<"$status" || true)"
    if [ "$new" != "$scene" ]; then
      scene="$new"
      echo >>"$work/scenes"
      curl -sf "$url/scene.ply" "$url/worst.jpg" >"$work/answer" || true
    fi
    sleep 1
  done
}

# Prints the training time, s.
seconds() {
  : >"$work/log"
  if [ $# -gt 0 ]; then look & fi
  "$splat" train "$capture" --steps "${STEPS:-1000}" --effects none --out "$work/out" "$@" >"$work/log" 2>&1 || { cat "$work/log" >&2 && exit 1; }
  sed -n 's/^    "train": \([0-9.]*\),*$/\1/p' "$work/out/metrics.json"
  rm -rf "$work/out"
}

: >"$work/ratios"
for pair in $(seq "${2:-9}"); do
  if [ $((pair % 2)) = 1 ]; then without="$(seconds)"; fi
  with="$(seconds --live)"
  if [ $((pair % 2)) = 0 ]; then without="$(seconds)"; fi
  echo "$without $with" | awk '{printf "%.2f s without, %.2f s with a page: %.3f\n", $1, $2, $2 / $1}' | tee -a "$work/ratios"
done
awk '{print $NF}' "$work/ratios" | sort -n | awk '{ratio[NR] = $1} END {print "median", (ratio[int((NR + 1) / 2)] + ratio[int(NR / 2) + 1]) / 2}'
echo "$(wc -l <"$work/scenes") scenes were loaded"
