#!/usr/bin/env bash
# Run a command where there is a vcan0: on this machine if its kernel has one, else in an emulated machine (in_uml.sh).
#
#   scripts/on_vcan.sh COMMAND [ARGUMENT …]
set -euo pipefail
[ $# -gt 0 ] || { echo "on_vcan.sh: no command given" >&2; exit 125; }
[ ! -d /sys/class/net/vcan0 ] || exec "$@"
exec "$(dirname "$0")/in_uml.sh" -m 1200M -r 70 "$@"
