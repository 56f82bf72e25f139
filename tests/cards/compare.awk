# Compares the table of today, the second file, with the recorded one, and fails where a kernel became worse. Prints what a change of the
# kernels changed: occupancy, registers, shared memory, instructions, and the cycles of a wave over the waves that hide them.

function finding(text) { print $1 ", " $2 ": " text; findings++ }
function changed(name, before, now) { if (before != now) changes = changes ", " name " " before " -> " now }
function hidden(latency, waves) { return waves > 0 ? int(latency / waves) : latency }

FNR == NR {
  if (FNR == 1) { for (i = 4; i <= 7; i++) names[i] = $i }
  else { recorded[$1 "\t" $2] = $4; spilled[$1 "\t" $2] = $9; row[$1 "\t" $2] = $0 }
  next
}

($1 "\t" $2) in row {
  split(row[$1 "\t" $2], before)
  changes = ""
  for (i = 4; i <= 7; i++) changed(names[i], before[i], $i)
  changed("cycles/waves", hidden(before[8], before[4]), hidden($8, $4))
  if (changes != "") print $1 ", " $2 changes
}

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
