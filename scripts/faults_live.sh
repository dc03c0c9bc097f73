#!/usr/bin/env bash
# Random faults in real time: so many trials of each, on the loopback bus between processes and on a real vcan0, the
# emulated machine's where this kernel has none. Each trial is a line of faults-<where>.jsonl (FAULTS_LOG names another
# folder); a run that was broken off goes on there. `node` tries what concerns the driver node: silence, bad commands, a
# killed planner, a killed driver. `loopback-slow` and `node-slow` are the loopback bus on an emulated machine in slow
# motion, for a machine that is too slow or too busy for it, as vcan0 is tried where the kernel has none.
#
#   scripts/faults_live.sh PYTHON TRIALS SEED [loopback|loopback-slow|vcan0|node|node-slow|node-vcan0 …]
set -uo pipefail
python=$1 trials=$2 seed=$3
shift 3
here=$(dirname "$0")
folder=${FAULTS_LOG:-.}
mkdir -p "$folder"
status=0

campaign() {
  "${@:3}" "$python" -m artibot_driver.faults "$trials" "$seed" --each --channel "$1" --log "$folder/faults-$2.jsonl"
}

node() {
  ARTIBOT_TRIALS=$trials ARTIBOT_SEED=$seed "${@:2}" "$python" -m pytest -q -s "$1"
}

slowly=("$here/in_uml.sh" -m 1200M -1 -s 8)

for where in "${@:-loopback vcan0}"; do
  for each in $where; do
    echo "== $each: $trials trials of each fault, seed $seed"
    case $each in
      loopback) campaign loopback loopback ;;
      loopback-slow) campaign loopback loopback-slow "${slowly[@]}" ;;
      vcan0) campaign vcan0 vcan0 "$here/on_vcan.sh" -s 8 ;;
      node) node test/nodes/test_driver_faults.py ;;
      node-slow) node test/nodes/test_driver_faults.py "${slowly[@]}" ;;
      node-vcan0) node test/can/test_driver_vcan.py ;;
      *) echo "faults_live.sh: found '$each', expected loopback, loopback-slow, vcan0, node, node-slow or node-vcan0" >&2; exit 2 ;;
    esac || status=$?
  done
done
exit "$status"
