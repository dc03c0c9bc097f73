#!/usr/bin/env bash
# Types and all tests: first those that ask for the whole machine in time, one by one; then what watches the clock and mostly
# waits, two files at a time. In its pauses begin all others, three files at a time, for some wait for processes of their own:
# those that compute for minutes are their first (test/conftest.py), and get the processor only while nobody else wants it.
# Once nothing watches the clock any more they have all of it, and behind them run the types and the tests on a kernel with
# CAN, if that is emulated, for then its clock waits for them. The summaries come last.
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
waiting=(test/nodes test/test_launch.py)
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

# Where several processes share the cores BLAS's own threads wait for each other: a sum then takes ten times as long.
export OPENBLAS_NUM_THREADS=1

behind() {
  local failed=0
  nice -n 5 "$python" -m mypy >"$reports/types" 2>&1 || failed=1
  [ ${#can[@]} = 0 ] || nice -n 5 "$python" -m pytest "${can[@]}" >"$reports/2-can" 2>&1 || failed=1
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

failed=0
"$python" -m pytest -o "cache_dir=$reports/cache-0" "${alone[@]}" 2>&1 | tee "$reports/0" ||
  again 0 "${alone[@]}" || failed=1
set -m # a process group of their own
priority low "$python" -m pytest -n 3 "${files[@]}" -o "cache_dir=$reports/cache-3" "${rest[@]}" >"$reports/3" 2>&1 </dev/null &
others=$!
set +m
trap 'kill -- -"$others"; kill -CONT -- -"$others"; end' EXIT
trap 'exit 130' INT TERM
if ! "$python" -m pytest -n 2 "${files[@]}" -o "cache_dir=$reports/cache-1" "${waiting[@]}" 2>&1 | tee "$reports/1"; then
  kill -STOP -- -"$others"
  again 1 "${waiting[@]}" || failed=1
  kill -CONT -- -"$others"
fi
priority usual "$others"
behind &
row=$!
tail -n +1 -f --pid="$others" "$reports/3"
wait "$others" && passed=yes || passed=no
trap end EXIT
wait "$row" || failed=1
[ "$passed" = yes ] || again 3 "${rest[@]}" || failed=1
[ ! -e "$reports/2-can" ] || cat "$reports/2-can"
cat "$reports/types"
grep -hE '^=+ .* in [0-9.]+s' "$reports"/[0-9]*
exit "$failed"
