#!/usr/bin/env bash
# All tests in three parts: first those that watch the clock and mostly wait, two files at a time; then those on a kernel
# with CAN, which may have to be emulated and then is slow, beside tests that only reckon and leave a processor free;
# then the rest, three files at a time, for they wait for processes of their own.
# With arguments they are pytest's, and it is one part.
#
#   scripts/test.sh PYTHON [PYTEST-ARGUMENT …]
set -uo pipefail
python=$1
shift
[ $# -eq 0 ] || exec "$python" -m pytest "$@"

waiting=(test/nodes test/test_demo.py test/test_launch.py test/driver/test_safety_loopback.py)
can=(test/can)
reckoning=(test/diagnose/test_run.py) # about as long
begun=("${waiting[@]}" "${can[@]}" "${reckoning[@]}")
failed=0
report=$(mktemp)
trap 'rm -f "$report"' EXIT

"$python" -m pytest -n 2 --dist loadfile "${waiting[@]}" || failed=$?

read -r -a cores < <("$python" -c 'import os; print(*sorted(os.sched_getaffinity(0)))')
if [ "${#cores[@]}" -gt 1 ]; then
  "$python" -m pytest "${can[@]}" >"$report" 2>&1 &
  others=$(IFS=,; echo "${cores[*]:1}")
  taskset -c "$others" "$python" -m pytest "${reckoning[@]}" || failed=$?
  wait $! || failed=$?
  cat "$report"
else
  "$python" -m pytest "${can[@]}" "${reckoning[@]}" || failed=$?
fi

[ "$failed" = 0 ] || echo "tests have failed already: see the summaries above" >&2
"$python" -m pytest -n 3 --dist loadfile "${begun[@]/#/--ignore=}" || failed=$?
exit "$failed"
