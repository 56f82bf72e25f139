# Makes a line of each card and kernel from the statistics of its forms: the fewest waves, and the largest of every other number.

function larger(key, value) { if (value > most[key]) most[key] = value }

{
  key = $1 "\t" $2
  if (!(key in forms)) waves[key] = 1000
  forms[key]++
  for (i = 3; i <= NF; i++) {
    split($i, pair, "=")
    value = pair[2] + 0
    if (pair[1] == "failed") failed[key]++
    else if (pair[1] == "Subgroups per SIMD") { if (value < waves[key]) waves[key] = value }
    else if (pair[1] == "Spilled VGPRs") spilled[key] += value
    else larger(key "\t" pair[1], value)
  }
}

END {
  for (key in forms) {
    printf "%s\t%d\t%d\t%d\t%d\t%d\t%d\t%d\t%d\n", key, forms[key], waves[key], most[key "\tVGPRs"], most[key "\tLDS size"],
      most[key "\tInstructions"], most[key "\tLatency"], spilled[key], failed[key]
  }
}
