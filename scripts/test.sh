#!/usr/bin/env bash
# All tests in two parts: first those that watch the clock and mostly wait, two files at a time, and beside them, with
# what they leave of the processors, those on a kernel with CAN, if that is emulated, for then its clock waits for them;
# after that the rest, three files at a time, for they wait for processes of their own. The summaries come last.
# With arguments they are pytest's, and it is one part.
#
#   scripts/test.sh PYTHON [PYTEST-ARGUMENT …]
set -uo pipefail
python=$1
shift
[ $# -eq 0 ] || exec "$python" -m pytest "$@"

waiting=(test/nodes test/test_demo.py test/test_launch.py test/driver/test_safety_loopback.py)
can=(test/can)
rest=("${waiting[@]/#/--ignore=}" "${can[@]/#/--ignore=}")
if [ -e /sys/class/net/vcan0 ]; then
  waiting+=("${can[@]}")
  can=()
fi

reports=$(mktemp -d)
trap 'kill $(jobs -p) 2>/dev/null; rm -rf "$reports"' EXIT
failed=0

[ ${#can[@]} = 0 ] || nice -n 19 "$python" -m pytest "${can[@]}" >"$reports/can" 2>&1 &
"$python" -m pytest -n 2 --dist loadfile "${waiting[@]}" 2>&1 | tee "$reports/waiting" || failed=$?
nice -n 19 "$python" -m pytest -n 3 --dist loadfile "${rest[@]}" 2>&1 | tee "$reports/rest" || failed=$?
wait $! || failed=$?
[ ! -e "$reports/can" ] || cat "$reports/can"
grep -hE '^=+ .* in [0-9.]+s' "$reports"/*
exit "$failed"
