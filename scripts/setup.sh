#!/usr/bin/env bash
# Make .venv ready to run artibot (`setup.sh run`), to develop and test it (`setup.sh dev`), or for the benchmark
# against other simulators (`setup.sh bench`) or on real recordings (`setup.sh real`). Quick when nothing changed.
#
# Environment: PYTHON   interpreter to use (3.10-3.13); default: the first fit one on PATH
#              VENV     where to put the virtual environment; default .venv
#
# Where a ROS 2 is sourced (AMENT_PREFIX_PATH), its rclpy is used and no ROS wheels are installed. Debian packages are
# installed only where something is missing, with root or sudo; without either, what is missing is said.
set -euo pipefail
cd "$(dirname "$0")/.."

stage=${1:-run}
venv=${VENV:-.venv}
case $stage in run | dev | bench | real) ;; *) echo "setup.sh: unknown stage '$stage'; expected run, dev, bench or real" >&2; exit 2 ;; esac

say() { printf 'setup: %s\n' "$*" >&2; }
die() { say "$*"; exit 1; }

fit() { "$1" -c 'import sys; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 13))' >/dev/null 2>&1; }
has_venv() { "$1" -c 'import ensurepip, venv' >/dev/null 2>&1; }
ros_sourced() { [ -n "${AMENT_PREFIX_PATH:-}" ] && [ -n "${ROS_DISTRO:-}" ]; }

# apt_install PACKAGE …: as root, or by sudo; false where that cannot be.
apt_install() {
  local sudo=()
  command -v apt-get >/dev/null || { say "no apt-get here"; return 1; }
  if [ "$(id -u)" != 0 ]; then
    command -v sudo >/dev/null || { say "neither root nor sudo"; return 1; }
    sudo -n true 2>/dev/null || [ -t 0 ] || { say "sudo asks for a password and there is no terminal"; return 1; }
    sudo=(sudo)
  fi
  say "installing Debian packages: $*"
  "${sudo[@]}" apt-get update -qq || say "apt-get update failed; going on with the lists there are"
  "${sudo[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$@" >&2
}

find_python() {
  local candidate
  if [ -n "${PYTHON:-}" ]; then
    fit "$PYTHON" || die "PYTHON=$PYTHON is no Python 3.10-3.13"
    echo "$PYTHON"
    return
  fi
  for candidate in python3 python3.12 python3.13 python3.11 python3.10 /usr/bin/python3; do
    if fit "$candidate"; then
      ros_sourced && ! "$candidate" -c 'import rclpy' >/dev/null 2>&1 && continue
      echo "$candidate"
      return
    fi
  done
}

choose_python() {
  python=$(find_python)
  if [ -z "$python" ]; then
    ros_sourced && die "ROS 2 $ROS_DISTRO is sourced, but no Python 3.10-3.13 here can import its rclpy; set PYTHON"
    apt_install python3 python3-venv || true
    python=$(find_python)
    [ -n "$python" ] || die "no Python 3.10-3.13 found; install one, or name it: make setup PYTHON=/path/to/python3.12"
  fi
  has_venv "$python" && return
  local version
  version=$("$python" -c 'import sys; print("python%d.%d" % sys.version_info[:2])')
  apt_install "$version-venv" || true
  has_venv "$python" || die "$python cannot make virtual environments; as root: apt-get install $version-venv"
}

# discard_venv: away with one that does not suit; what is no virtual environment is never touched.
discard_venv() {
  [ -e "$venv" ] || return 0
  [ -f "$venv/pyvenv.cfg" ] || die "$venv exists and is no virtual environment; move it away, or set VENV"
  local sees_system=no wanted=no
  ! grep -qi '^include-system-site-packages *= *true' "$venv/pyvenv.cfg" || sees_system=yes
  ! ros_sourced || wanted=yes
  if ! fit "$venv/bin/python" || ! "$venv/bin/python" -m pip --version >/dev/null 2>&1; then
    say "$venv: its Python is gone, unfinished or not 3.10-3.13; making it anew"
  elif [ $sees_system != $wanted ]; then
    say "$venv was made with$([ $wanted = yes ] && echo out) a ROS 2 sourced; making it anew"
  else
    return 0
  fi
  rm -rf "$venv"
}

make_venv() {
  discard_venv
  [ -e "$venv" ] && return
  local options=()
  choose_python
  ! ros_sourced || options+=(--system-site-packages)
  say "making $venv with $("$python" --version)"
  "$python" -m venv "${options[@]}" "$venv"
}

# A ROS 2 that is sourced was compiled against one numpy: keep to it.
install_packages() {
  local extras=$1 pins=() pip_options=()
  if ros_sourced; then
    say "using the rclpy of ROS 2 $ROS_DISTRO"
    if "$venv/bin/python" -c 'import numpy' 2>/dev/null; then
      "$venv/bin/python" -c 'import numpy; print("numpy==" + numpy.__version__)' >"$venv/constraints.txt"
      pins=(-c "$venv/constraints.txt")
    fi
  else
    extras="ros${extras:+,$extras}"
  fi
  say "installing artibot_sim${extras:+[$extras]} (a few minutes the first time)"
  [ -t 2 ] || pip_options+=(--quiet)  # on a terminal its progress is seen
  "$venv/bin/python" -m pip install "${pip_options[@]}" --no-compile --disable-pip-version-check "${pins[@]}" --editable ".${extras:+[$extras]}" >&2 ||
    die "pip could not install what setup.py lists. The ROS wheels exist for x86-64 Linux only: elsewhere, source a ROS 2 Jazzy first"
  # pip would compile modules on one processor, and others' tests with them: most of what an installation costs
  "$venv/bin/python" -m compileall -qq -j 0 -x '/tests/' "$venv"/lib/python*/site-packages >&2 || true
  "$venv/bin/python" -c 'import rclpy' || die "rclpy does not import in $venv; remove $venv and try again"
}

# For the tests on a real CAN and in a browser. Without these they are skipped, so this is never fatal.
install_test_packages() {
  local missing=()
  export PATH="$PATH:/usr/sbin:/sbin"
  command -v linux.uml >/dev/null || missing+=(user-mode-linux)
  command -v insmod >/dev/null || missing+=(kmod)
  command -v ip >/dev/null || missing+=(iproute2)
  command -v cc >/dev/null || missing+=(gcc libc6-dev)
  command -v candump >/dev/null || missing+=(can-utils)
  command -v chromium >/dev/null || command -v chromium-browser >/dev/null || missing+=(chromium)
  [ ${#missing[@]} = 0 ] && return
  apt_install "${missing[@]}" || say "left out: ${missing[*]}; the tests on a real CAN or in a browser that need them will be skipped"
}

case $stage in run) extras= ;; dev) extras=test,dev ;; bench) extras=bench ;; real) extras=real ;; esac
[ "$stage" != dev ] || install_test_packages

stamp=$venv/.ready-$stage
want=$(cat setup.py setup.cfg scripts/setup.sh | cksum; echo "${ROS_DISTRO:-}"; pwd)
if [ -e "$stamp" ] && [ "$(cat "$stamp")" = "$want" ] && [ -x "$venv/bin/python" ]; then exit 0; fi
make_venv
install_packages "$extras"
printf '%s' "$want" >"$stamp"
say "$venv is ready"
