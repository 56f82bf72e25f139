# Compares the table of today, the second file, with the recorded one, and fails where a kernel became worse.

function finding(text) { print $1 ", " $2 ": " text; findings++ }

FNR == NR { if (FNR > 1) recorded[$1 "\t" $2] = $4; next }

{
  kernels++
  if ($10 > 0) finding($10 " of " $3 " forms do not compile")
  if ($9 > 0) finding("spills " $9 " registers")
  if (!(($1 "\t" $2) in recorded)) finding("not recorded: run SPLAT_CARDS=accept .ci/run cards")
  else if ($4 < recorded[$1 "\t" $2]) finding($4 " waves, recorded are " recorded[$1 "\t" $2])
}

END {
  if (kernels == 0) { print "no kernels"; exit 1 }
  print kernels " kernels of cards, " findings + 0 " findings"
  exit findings > 0
}
