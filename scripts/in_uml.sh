#!/usr/bin/env bash
# Run a command on a machine whose kernel has no CAN: boots Linux as an ordinary process (user-mode Linux, a second or two)
# on this machine's own files, brings up vcan0 inside, and runs the command there.
#
#   scripts/in_uml.sh [-1] [-m MEMORY] [-s FACTOR] [-r PRIORITY] COMMAND [ARGUMENT …]
#
# -s 8 is slow motion: the machine's clocks run 8 times slower than this machine's while it works, and what it sleeps
# through is skipped (slow_motion.c). What must keep up with the clock then does, whatever else runs here: for trying how
# programs behave, not how fast they are. -r 10 has the kernel preferred to all ordinary processes, where that is allowed.
# The command sees the same files, working directory and environment; its output goes to standard output, and its
# status is this script's. Status 125: the kernel did not come so far; what it said is on standard error.
# -1 keeps it on one processor, which one is left to chance: beside other work it is then twice as fast, for its processes
# hand over to each other at every system call, and whatever else watches the clock there waits longer.
# Needs Debian's packages user-mode-linux, kmod and iproute2, and a C compiler for -s and for processors with AMX
# (wide_registers.c). One CPU; no network but the loopback.
set -euo pipefail

memory=256M
preferred=()
pinned=()
slowness=
while getopts 1m:r:s: option; do
  case $option in
    1) pin=(taskset -c $((RANDOM % $(nproc)))) && "${pin[@]}" true 2>/dev/null && pinned=("${pin[@]}") ;;
    m) memory=$OPTARG ;;
    s) slowness=$OPTARG ;;
    r) chrt -f "$OPTARG" true 2>/dev/null && preferred=(chrt -f "$OPTARG") ;;
    *) sed -n '2,15s/^# \{0,1\}//p' "$0" >&2; exit 125 ;;
  esac
done
shift $((OPTIND - 1))
[ $# -gt 0 ] || { echo "in_uml.sh: no command given" >&2; exit 125; }

kernel=$(command -v linux.uml) || { echo "in_uml.sh: linux.uml not found; apt-get install user-mode-linux" >&2; exit 125; }
command -v insmod >/dev/null || [ -x /sbin/insmod ] || { echo "in_uml.sh: insmod not found; apt-get install kmod" >&2; exit 125; }
command -v ip >/dev/null || [ -x /sbin/ip ] || { echo "in_uml.sh: ip not found; apt-get install iproute2" >&2; exit 125; }
modules=$(find /usr/lib/uml/modules -mindepth 1 -maxdepth 1 -type d 2>/dev/null | sort -V | tail -n 1)
[ -n "$modules" ] || { echo "in_uml.sh: no kernel modules in /usr/lib/uml/modules" >&2; exit 125; }

work=$(mktemp -d)
machine=
trap '[ -z "$machine" ] || kill "$machine" 2>/dev/null || true; rm -rf "$work"' EXIT
trap 'exit 130' INT TERM

# preload NAME WHY: NAME.c, compiled, to be loaded before the kernel's C library.
preloaded=
preload() {
  "${CC:-cc}" -O2 -shared -fPIC -o "$work/$1.so" "$(dirname "$0")/$1.c" -ldl >&2 ||
    { echo "in_uml.sh: $2 needs a C compiler; apt-get install gcc libc6-dev" >&2; exit 125; }
  preloaded+="${preloaded:+:}$work/$1.so"
}

if [ -n "$slowness" ]; then
  [[ $slowness =~ ^[1-9][0-9]{0,2}$ ]] || { echo "in_uml.sh: -s is '$slowness', expected a whole number from 1 to 999" >&2; exit 125; }
  preload slow_motion -s
fi
! grep -qw amx_tile /proc/cpuinfo || preload wide_registers "a processor with AMX"

# The first program of the new system: it gets the environment and the command as bash writes them down itself.
{
  echo '#!/bin/bash'
  declare -px | grep -vE '^declare -[a-zA-Z-]*x[a-zA-Z-]* (BASH|EUID|PPID|SHELLOPTS|UID|TMOUT)'
  printf 'export IN_UML=1 PATH="$PATH:/usr/sbin:/sbin"\n'
  # When a handler of a signal returns, this kernel gives the interrupted program its AVX registers back, and not those of
  # AVX-512: what the handler left there stays. The C library copies memory with them, in a handler and in what it interrupts.
  printf 'export GLIBC_TUNABLES="${GLIBC_TUNABLES:+$GLIBC_TUNABLES:}glibc.cpu.hwcaps=-AVX512F,-AVX512VL,-AVX512BW"\n'
  printf 'modules=%q work=%q directory=%q command=(' "$modules" "$work" "$PWD"
  printf '%q ' "$@"
  printf ')\n'
  cat <<'BOOT'
mount -t proc proc /proc
mount -t sysfs sysfs /sys
mount -t tmpfs tmpfs /dev/shm 2>/dev/null || { mkdir -p /dev/shm && mount -t tmpfs tmpfs /dev/shm; }
for module in net/can/can net/can/can-raw net/can/can-bcm drivers/net/can/dev/can-dev drivers/net/can/vcan; do
  file=$(compgen -G "$modules/kernel/$module.ko*" | head -n 1)
  [ -z "$file" ] || insmod "$file"
done
# A frame's stamp is when programs can read it: the thread that hands frames over may be long in coming to it.
echo 0 >/proc/sys/net/core/netdev_tstamp_prequeue
ip link set lo up && ip link add dev vcan0 type vcan && ip link set vcan0 up && touch "$work/up"
if [ -e "$work/up" ] && cd "$directory"; then
  "${command[@]}" </dev/null >"$work/out" 2>&1
  echo $? >"$work/status"
fi
sync
halt -f || poweroff -f
BOOT
} >"$work/init"
chmod +x "$work/init"
: >"$work/out"

# The command writes to a file, shown as it grows: the kernel's console would mix in lines of its own. What would be
# timed at boot for the sake of file systems on RAID is left out.
"${pinned[@]}" "${preferred[@]}" env ${preloaded:+LD_PRELOAD="$preloaded" SLOW_MOTION="$slowness"} setpriv --pdeathsig KILL \
  "$kernel" "mem=$memory" root=/dev/root rootfstype=hostfs rootflags=/ rw init="$work/init" \
  initcall_blacklist=raid6_select_algo,calibrate_xor_blocks con=null con0=fd:0,fd:1 quiet </dev/null >"$work/console" 2>&1 &
machine=$!
tail -f -c +1 -s 0.1 --pid="$machine" "$work/out" &
wait "$machine" || true
wait # for tail, which ends by itself once all is shown

if [ ! -s "$work/status" ]; then
  cat "$work/console" >&2
  echo "in_uml.sh: the kernel did not get as far as running the command" >&2
  exit 125
fi
exit "$(cat "$work/status")"
