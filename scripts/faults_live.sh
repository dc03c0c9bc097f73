#!/usr/bin/env bash
# Random faults in real time: so many trials of each, on the loopback bus between processes and on a real vcan0, the
# emulated machine's where this kernel has none. Each trial is a line of faults-<where>.jsonl (FAULTS_LOG names another
# folder); a run that was broken off goes on there. `node` tries what concerns the driver node: silence, bad commands, a
# killed planner, a killed driver.
#
#   scripts/faults_live.sh PYTHON TRIALS SEED [loopback|vcan0|node|node-vcan0 …]
set -uo pipefail
python=$1 trials=$2 seed=$3
shift 3
here=$(dirname "$0")
folder=${FAULTS_LOG:-.}
mkdir -p "$folder"
status=0

campaign() {
  "${@:2}" "$python" -m artibot_driver.faults "$trials" "$seed" --each --channel "$1" --log "$folder/faults-$1.jsonl"
}

for where in "${@:-loopback vcan0}"; do
  for each in $where; do
    echo "== $each: $trials trials of each fault, seed $seed"
    case $each in
      loopback) campaign loopback ;;
      vcan0) campaign vcan0 "$here/on_vcan.sh" -s 8 ;;
      node) ARTIBOT_TRIALS=$trials ARTIBOT_SEED=$seed "$python" -m pytest -q -s test/nodes/test_driver_faults.py ;;
      node-vcan0) ARTIBOT_TRIALS=$trials ARTIBOT_SEED=$seed "$python" -m pytest -q -s test/can/test_driver_vcan.py ;;
      *) echo "faults_live.sh: found '$each', expected loopback, vcan0, node or node-vcan0" >&2; exit 2 ;;
    esac || status=$?
  done
done
exit "$status"
