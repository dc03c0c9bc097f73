#!/usr/bin/env bash
# Types and all tests. What watches the clock goes first: one by one what asks for the whole machine in time, then, two files
# at a time, what mostly waits. In its pauses runs what only computes, three files at a time, those that take longest first
# (test/conftest.py): it gets the processor only while nobody else wants it. Once nothing watches the clock any more the tests
# on a kernel with CAN run, if that is emulated, for then its clock waits for them: not before, for an emulated kernel is in
# a session of its own, where its priority cannot be raised again. They and the types are one long row that keeps one
# processor at most: it goes before what computes, which takes the rest, so that no processor waits for the row at the end.
# The summaries come last.
# Whole diagnoses and what else takes long is left to `make test-long`, but for a slice.
# What watches the clock fails where the machine stands still for a moment: a few tests are tried again, one by one, and
# those that fail then in slow motion (in_uml.sh), where no machine stands still. Who fails there, too, has failed.
# With arguments they are pytest's, and it is one part.
#
#   scripts/test.sh PYTHON [PYTEST-ARGUMENT …]
set -uo pipefail
python=$1
shift
if [ $# -gt 0 ]; then
  "$python" -m mypy && exec "$python" -m pytest "$@"
  exit 1
fi

# Whole files to each process, those that take longest first (test/conftest.py): none is left alone with one at the end.
files=(--dist loadfile --no-loadscope-reorder)
alone=(test/test_demo.py test/driver/test_safety_loopback.py test/driver/test_drives_command.py)
waiting=(test/nodes test/driver/test_foreign_drives.py test/test_launch.py test/view)
can=(test/can)
rest=("${alone[@]/#/--ignore=}" "${waiting[@]/#/--ignore=}" "${can[@]/#/--ignore=}")
if [ -e /sys/class/net/vcan0 ]; then
  waiting+=("${can[@]}")
  can=()
fi

reports=$(mktemp -d)
end() {
  kill $(jobs -p) 2>/dev/null
  rm -rf "$reports"
}
trap end EXIT

# What is compiled of sources, and of tests, is kept: else each of many hundred processes would compile it again.
unset PYTHONDONTWRITEBYTECODE
# Where several processes share the cores BLAS's own threads wait for each other: a sum then takes ten times as long.
export OPENBLAS_NUM_THREADS=1

row() {
  local failed=0
  [ ${#can[@]} = 0 ] || "$python" -m pytest "${can[@]}" >"$reports/2-can" 2>&1 || failed=1
  "$python" -m mypy >"$reports/types" 2>&1 || failed=1
  return "$failed"
}

# again PART PATH …: what failed of a part, at most twice, with nothing beside it; the second time in slow motion.
few=24
again() {
  local part=$1 cache=(-o "cache_dir=$reports/cache-$1") round count slowly=()
  shift
  for round in 1 2; do
    count=$("$python" -c 'import json, sys; print(len(json.load(open(sys.argv[1]))))' \
      "$reports/cache-$part/v/cache/lastfailed" 2>/dev/null) || return 1
    [ "$count" -gt 0 ] && [ "$count" -le "$few" ] || return 1
    echo "tried again, with nothing beside${slowly[*]:+, in slow motion}: $count of the tests"
    "${slowly[@]}" "$python" -m pytest "${cache[@]}" --last-failed "$@" 2>&1 | tee "$reports/$part-again-$round" && return 0
    slowly=("$(dirname "$0")/in_uml.sh" -m 1600M -1 -s 8)
  done
  return 1
}

priority() { "$python" "$(dirname "$0")/priority.py" "$@"; }

# watched PART [OPTION …] -- PATH …: tests that watch the clock, and again those that fail, while what computes stands still.
watched() {
  local part=$1 options=()
  shift
  while [ "$1" != -- ]; do options+=("$1") && shift; done
  shift
  "$python" -m pytest "${options[@]}" -o "cache_dir=$reports/cache-$part" "$@" 2>&1 | tee "$reports/$part" && return 0
  kill -STOP -- "-$others"
  local passed=0
  again "$part" "$@" || passed=1
  kill -CONT -- "-$others"
  return "$passed"
}

failed=0
set -m # a process group of its own
priority low nice -n 5 "$python" -m pytest -n 3 -m "not long" --durations=25 --durations-min=2 "${files[@]}" -o "cache_dir=$reports/cache-3" "${rest[@]}" >"$reports/3" 2>&1 </dev/null &
others=$!
set +m
trap 'kill -- "-$others"; kill -CONT -- "-$others"; end' EXIT
trap 'exit 130' INT TERM
watched 0 -- "${alone[@]}" || failed=1
watched 1 -n 2 "${files[@]}" -- "${waiting[@]}" || failed=1
priority usual "$others"
row </dev/null &
row=$!
tail -n +1 -f --pid="$others" "$reports/3"
wait "$others" && passed=yes || passed=no
wait "$row" || failed=1
trap end EXIT
[ "$passed" = yes ] || again 3 -m "not long" "${rest[@]}" || failed=1
[ ! -e "$reports/2-can" ] || cat "$reports/2-can"
cat "$reports/types"
grep -hE '^=+ .* in [0-9.]+s' "$reports"/[0-9]*
exit "$failed"
