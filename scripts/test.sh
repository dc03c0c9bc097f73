#!/usr/bin/env bash
# All tests in three parts: first those that watch the clock and mostly wait, two files at a time; then those of the bus,
# one by one, because the emulated kernel that has CAN is slow; then the others, two files at a time.
# With arguments they are pytest's, and it is one part.
#
#   scripts/test.sh PYTHON [PYTEST-ARGUMENT …]
set -uo pipefail
python=$1
shift
[ $# -eq 0 ] || exec "$python" -m pytest "$@"

waiting=(test/nodes test/test_demo.py test/test_launch.py)
bus=(test/can test/driver/test_safety_loopback.py)
failed=0
"$python" -m pytest -n 2 --dist loadfile "${waiting[@]}" || failed=$?
"$python" -m pytest "${bus[@]}" || failed=$?
[ "$failed" = 0 ] || echo "tests that watch the clock failed: see the summaries above" >&2
"$python" -m pytest -n 2 --dist loadfile "${waiting[@]/#/--ignore=}" "${bus[@]/#/--ignore=}" || failed=$?
exit "$failed"
