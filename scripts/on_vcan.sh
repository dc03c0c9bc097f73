#!/usr/bin/env bash
# Run a command where there is a vcan0: on this machine if its kernel has one, else in an emulated machine (in_uml.sh).
#
#   scripts/on_vcan.sh [-s FACTOR] COMMAND [ARGUMENT …]
#
# -s has the emulated machine work in slow motion on one processor, as for in_uml.sh; without it, it is preferred to all
# ordinary processes.
set -euo pipefail
how=(-r 70)
[ "${1:-}" != -s ] || { how=(-1 "${@:1:2}"); shift 2; }
[ $# -gt 0 ] || { echo "on_vcan.sh: no command given" >&2; exit 125; }
[ ! -d /sys/class/net/vcan0 ] || exec "$@"
exec "$(dirname "$0")/in_uml.sh" -m 1200M "${how[@]}" "$@"
