#!/usr/bin/env bash
# Trains every capture of a folder with every strategy of `splat train`, one run after the other, and writes a row of
# docs/records.tsv for each. A row is a run that is done and is skipped; remove it to repeat the run. An interrupted run
# continues from its last checkpoint.
#
#   benches/records.sh [DATA]     all runs, on the captures in DATA or else SPLAT_DATA_DIR (docs/CAPTURES.md)
#
# Variables: CAPTURES, STRATEGIES and STEPS (lists; all, all, and 2000 7000 30000), SIDE and SPLATS (largest side of the
# photographs, px, and largest number of Gaussians in long runs; 400 and 120000), LPIPS (weights), SPLAT (the program; built
# if not named), WORK (folder of the runs; out/records), RECORDS (the file that is written).
set -euo pipefail
cd "$(dirname "$0")/.."
records="${RECORDS:-docs/records.tsv}"
work="${WORK:-out/records}"
fields=(capture steps strategy side cap psnr ssim lpips splats seconds peak_mib device commit date)

# Prints the first number of a key in metrics.json, or `-`. Each key has a line of its own, indented by its depth, 1 or 2.
number() {
  local value
  value="$(sed -n "s/^ \{$((2 * $2))\}\"$3\": \([-0-9.e]*\),\{0,1\}\$/\1/p" "$1" | head -1)"
  echo "${value:--}"
}

# Prints the strategies of the program, one on a line.
strategies() {
  "$splat" train --help | awk '/^ +--strategy /{found=1; next} found && /^ +--/{exit} found && $1 == "-" {sub(":", "", $2); print $2}'
}

# Prints the largest side of the photographs, px, or `-` for their own size. Small photographs have it in all but the longest runs.
side() {
  case "$1:$2" in
  fox_small:7000 | lego_alpha:7000 | demo:* | *:2000) echo - ;;
  *) echo "${SIDE:-400}" ;;
  esac
}

# Prints the largest number of Gaussians, or `-` for the program's own limit. Strategies are compared at equal numbers.
cap() { if [ "$1" = 2000 ]; then echo -; else echo "${SPLATS:-120000}"; fi; }

is_done() { [ -f "$records" ] && awk -F'\t' -v key="$1" '$1 "\t" $2 "\t" $3 "\t" $4 "\t" $5 == key {found=1} END {exit !found}' "$records"; }

# Appends the row of a finished run.
record() {
  local from="$2/metrics.json"
  if [ ! -f "$records" ]; then (IFS=$'\t'; echo "${fields[*]}") >"$records"; fi
  local row=("$1" "$(number "$from" 2 psnr)" "$(number "$from" 2 ssim)" "$(number "$from" 2 lpips)" "$(number "$from" 1 splats)")
  row+=("$(number "$from" 2 train)" "$(number "$from" 1 peak_rss_mib)" "$(sed -n 's/^  "device": "\(.*\)",$/\1/p' "$from")")
  row+=("$(git rev-parse --short HEAD)" "$(date +%F)")
  (IFS=$'\t'; echo "${row[*]}") >>"$records"
}

# Trains, or continues what was interrupted. A signal to this script reaches the program, which saves a checkpoint.
train() {
  local capture="$1" steps="$2" strategy="$3" side="$4" cap="$5" out="$6"
  local options=("$capture" --steps "$steps" --strategy "$strategy" --out "$out")
  if [ "$side" != - ]; then options+=(--max-side "$side"); fi
  if [ "$cap" != - ]; then options+=(--max-splats "$cap"); fi
  if [ -n "${LPIPS:-}" ]; then options+=(--lpips "$LPIPS"); fi
  if compgen -G "$out/checkpoints/step-*" >/dev/null; then "$splat" resume "$out" & else "$splat" train "${options[@]}" & fi
  local child=$!
  trap 'kill -TERM "$child" 2>/dev/null' TERM
  # Ctrl-C reaches the program without help, and a second signal would end it before its checkpoint.
  trap : INT
  # A trapped signal ends the first `wait` before the program has saved its checkpoint.
  local status=0
  wait "$child" || status=$?
  if kill -0 "$child" 2>/dev/null; then wait "$child" || status=$?; fi
  trap - INT TERM
  return "$status"
}

data="${1:-${SPLAT_DATA_DIR:-}}"
if [ ! -d "$data" ]; then
  echo "no folder of captures: benches/records.sh DATA, or set SPLAT_DATA_DIR" >&2
  exit 2
fi
splat="${SPLAT:-}"
if [ -z "$splat" ]; then
  # Without `-p`, so that Burn is compiled once for this and the tests.
  cargo build --locked --release
  splat="${CARGO_TARGET_DIR:-target}/release/splat"
fi
mkdir -p "$work"
failed=0
for steps in ${STEPS:-2000 7000 30000}; do
  for folder in "$data"/*/; do
    capture="$(basename "$folder")"
    if [ ! -d "$folder/images" ] && ! compgen -G "$folder/transforms*.json" >/dev/null; then continue; fi
    if [[ -n "${CAPTURES:-}" && " $CAPTURES " != *" $capture "* ]]; then continue; fi
    for strategy in ${STRATEGIES:-$(strategies)}; do
      side="$(side "$capture" "$steps")"
      cap="$(cap "$steps")"
      key="$capture"$'\t'"$steps"$'\t'"$strategy"$'\t'"$side"$'\t'"$cap"
      if is_done "$key"; then continue; fi
      out="$work/$capture-$steps-$strategy-$side-$cap"
      echo "records: $capture, $steps steps, $strategy, side $side, at most $cap Gaussians" >&2
      status=0
      if [ ! -f "$out/metrics.json" ]; then train "$folder" "$steps" "$strategy" "$side" "$cap" "$out" || status=$?; fi
      case "$status" in
      0) record "$key" "$out" ;;
      # Ended by Ctrl-C, SIGKILL or SIGTERM: the same command continues.
      130 | 137 | 143) exit "$status" ;;
      *) failed=1 ;;
      esac
    done
  done
done
exit "$failed"
