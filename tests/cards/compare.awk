# Compares the table of today, the second file, with the recorded one, and fails where a kernel became worse.

function finding(text) { print $1 ", " $2 ": " text; findings++ }

FNR == NR { if (FNR > 1) { recorded[$1 "\t" $2] = $4; spilled[$1 "\t" $2] = $9 } next }

{
  kernels++
  found[$1 "\t" $2]
  cards[$1]
  everywhere[$2]
  if ($10 > 0) finding($10 " of " $3 " forms do not compile")
  if ($9 > spilled[$1 "\t" $2] + 0) finding("spills " $9 " registers, recorded are " spilled[$1 "\t" $2] + 0)
  if (!(($1 "\t" $2) in recorded)) finding("not recorded: run SPLAT_CARDS=accept .ci/run cards")
  else if ($4 < recorded[$1 "\t" $2]) finding($4 " waves, recorded are " recorded[$1 "\t" $2])
}

END {
  for (key in recorded) {
    if (!(key in found)) { sub(/\t/, ", ", key); print key ": recorded, and no longer compiled"; findings++ }
  }
  for (card in cards) {
    for (kernel in everywhere) {
      if (!((card "\t" kernel) in found)) { print card ", " kernel ": not compiled, as on other cards"; findings++ }
    }
  }
  if (kernels == 0) { print "no kernels"; exit 1 }
  print kernels " kernels of cards, " findings + 0 " findings"
  exit findings > 0
}
