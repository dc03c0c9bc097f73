#!/usr/bin/env bash
# All tests, two files at a time and in two halves: first those that watch the clock, which mostly wait, among
# themselves; then the others, which keep both processors busy.
# With arguments they are pytest's, and it is one half.
#
#   scripts/test.sh PYTHON [PYTEST-ARGUMENT …]
set -uo pipefail
python=$1
shift
[ $# -eq 0 ] || exec "$python" -m pytest "$@"

alone=(test/nodes test/can test/driver/test_safety_loopback.py test/test_demo.py test/test_launch.py)
"$python" -m pytest -n 2 --dist loadfile "${alone[@]}"
first=$?
"$python" -m pytest -n 2 --dist loadfile "${alone[@]/#/--ignore=}"
second=$?
[ "$first" = 0 ] || echo "the tests that watch the clock failed: see the first summary" >&2
exit $((first ? first : second))
