#!/usr/bin/env bash
# Makes the pictures of the README and of docs/ again, on the CPU, in a quarter of an hour. Needs ImageMagick and chromium.
# `benches/pictures.sh target/release/splat`. The plots of docs/pareto are drawn of the tables beside them; `splat pareto` writes those tables
# (docs/ACCURACY.md), and `cargo bench --bench scale` the tables and plots of docs/scale.
set -euo pipefail
SPLAT_PLOTS=accept cargo test --release -p splat-benches --test plots
splat=$(realpath "$1")
docs=$(realpath "$(dirname "$0")/../docs")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"

# Splits photograph, render and error of a run's test view: RUN VIEW.
parts() { convert "$1/views/$2.png" -crop 3x1@ +repage "$1-%d.png"; }

# Joins pictures with four white pixels between them: FILE PICTURE...
beside() { convert "${@:2}" -background white -gravity east -splice 4x0 +append -chop 4x0 -strip "$docs/pictures/$1.png"; }

# A page as a picture: ADDRESS WIDTH,HEIGHT FILE.
page() {
  chromium --headless --no-sandbox --hide-scrollbars --use-angle=swiftshader --enable-unsafe-swiftshader \
    --virtual-time-budget=20000 --window-size="$2" --screenshot="$3" "$1" 2>/dev/null
}

train() { "$splat" train "$@" --device cpu --quiet; }

"$splat" demo --masks --out masks --views 40 --width 160 --height 120
train masks --out masks-none --steps 600 --sh-degree 0 --effects none
train masks --out masks-auto --steps 600 --sh-degree 0 --effects auto
parts masks-none 0008 && parts masks-auto 0008
beside floaters-masks masks-none-0.png masks-none-1.png masks-auto-1.png

"$splat" demo --out small --views 40
"$splat" demo --out zoom --zoom --views 30 --seed 3
for effects in none antialias; do
  train small --max-side 80 --out "small-$effects" --steps 3000 --sh-degree 0 --effects "$effects"
  "$splat" render --capture zoom --scene "small-$effects/scene.ply" --view 0010.png --out "near-$effects" --device cpu
done
beside needles-antialias zoom/images/0010.png near-none/0010.png near-antialias/0010.png

"$splat" demo --poses --out poses --views 40
train poses --out poses-none --steps 1200 --sh-degree 0 --effects none
train poses --out poses-auto --steps 1200 --sh-degree 0 --effects auto
parts poses-none 0008 && parts poses-auto 0008
beside blurry-poses poses-none-0.png poses-none-1.png poses-auto-1.png

train small --out all --steps 2000 --sh-degree 3 --sh-every 300 --effects none
train small --out less --steps 2000 --sh-degree 0 --max-splats 8000 --effects none
parts all 0008 && parts less 0008
beside memory-splats all-0.png all-1.png less-1.png

for loss in l1-ssim surfaces; do
  train small --out "loss-$loss" --steps 2000 --sh-degree 0 --effects none --loss "$loss"
  "$splat" render --capture small --scene "loss-$loss/scene.ply" --view 0008.png --pass normals --out "normals-$loss" --device cpu
done
beside mesh-surfaces small/images/0008.png normals-l1-ssim/0008.png normals-surfaces/0008.png

train --out demo
convert demo/views/0008.png -strip "$docs/demo.png"
page "file://$work/demo/report.html" 825,1312 "$docs/report.png"

"$splat" train small --out live --steps 6000 --device cpu --quiet --live=7117 &
sleep 60
page http://127.0.0.1:7117/ 1100,1250 "$docs/pictures/live.png"
kill %1

for run in masks-none masks-auto small-none small-antialias poses-none poses-auto all less demo; do
  jq -r "\"$run: \(.test.psnr) dB, \(.splats) splats, \(.peak_rss_mib) MiB; \" + (.test.views[] | select(.name == \"0008.png\") | \"0008: \(.psnr) dB\")" \
    "$run/metrics.json"
done
