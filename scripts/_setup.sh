# shellcheck shell=bash
# The environment of scripts/demo, scripts/test and scripts/docs, in one place. Sourced by them, not run.
#
#   use_environment runtime|test|docs    makes it if need be, and switches this shell to it
#   use_tools wheels                     makes one of tools alone, whose Python is in $venv/bin
#
# With ROS 2 sourced (Jazzy, Kilted, Lyrical or Rolling) it is a virtual environment on top of that ROS's
# Python, with only what is missing there. Otherwise everything comes from the Python package index, ROS 2
# included. It lives in .venv/ of the checkout, one directory per Python and kind, and is made again when
# requirements/ or the Python change.
#
# PYTHON=python3.12       which Python to use (3.11 to 3.14)
# WHEELS=kilted           without ROS sourced: which ROS 2 (jazzy, or kilted, which alone has Python 3.14)
# VERSIONS=ubuntu-24.04   without ROS sourced: the versions that Ubuntu 24.04 has, such as numpy 1.26

set -euo pipefail

root=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd -P)

say() {
  printf '[setup] %s\n' "$*" >&2
}

fail() {
  printf '[setup] Error: %s\n' "$@" >&2
  exit 1
}

in_range() {
  "$1" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 14))' &>/dev/null </dev/null
}

# Set base_python to the Python that can import the sourced ROS, if there is one.
find_ros_python() {
  local candidate candidates=(python3 /usr/bin/python3)
  [[ ${ROS_DISTRO:-} =~ ^(jazzy|kilted|lyrical|rolling)$ ]] || return 1
  [[ -z ${PYTHON:-} ]] || candidates=("$PYTHON")
  for candidate in "${candidates[@]}"; do
    if in_range "$candidate" && "$candidate" -c 'import rclpy' &>/dev/null </dev/null; then
      base_python=$candidate
      return 0
    fi
  done
  return 1
}

# Set base_python to a Python that the wheels exist for.
find_any_python() {
  local candidate
  if [[ -n ${PYTHON:-} ]]; then
    in_range "$PYTHON" || fail "PYTHON=$PYTHON is no Python 3.11 to 3.14." \
      "Set PYTHON to one, or unset it to have one looked for."
    base_python=$PYTHON
    return
  fi
  for candidate in python3 python3.12 python3.13 python3.11 python3.14 /usr/bin/python3; do
    if in_range "$candidate"; then
      base_python=$candidate
      return
    fi
  done
  fail "no Python 3.11 to 3.14 was found (python3 is: $(python3 --version 2>&1 || true))." \
    "Install one, or set PYTHON to its path."
}

# Set distribution: the ROS 2 that the wheels are of.
choose_wheels() {
  distribution=${WHEELS:-jazzy}
  if [[ -z ${WHEELS:-} ]] && "$base_python" -c 'import sys; sys.exit(sys.version_info < (3, 14))'; then
    distribution=kilted
  fi
  [[ $distribution =~ ^(jazzy|kilted)$ ]] || fail "WHEELS=$distribution is unknown: expected jazzy or kilted."
}

# Set kind (ros or pypi), base_python, distribution and name (of the directory in .venv).
choose_kind() {
  local suffix=''
  if find_ros_python; then
    kind=ros distribution=$ROS_DISTRO
  else
    kind=pypi
    leave_other_ros
    find_any_python
    choose_wheels
  fi
  [[ $distribution == jazzy ]] || suffix=-$distribution
  name=$kind-$("$base_python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')$suffix${VERSIONS:+-$VERSIONS}
  # Not the Python of an environment that happens to be active: it may be the one that is about to be remade.
  base_python=$("$base_python" -c 'import os, sys; print(os.path.realpath(sys._base_executable))')
}

# A ROS that cannot be used must not be found half-way either: its paths come before those of the wheels.
leave_other_ros() {
  if [[ -n ${ROS_DISTRO:-} ]]; then
    say "ROS 2 '$ROS_DISTRO' is sourced, but is none of Jazzy, Kilted, Lyrical and Rolling, or"
    say "${PYTHON:-python3} does not import its rclpy. It is left aside: ROS 2 comes from the Python package index."
  fi
  unset ROS_DISTRO ROS_VERSION ROS_PYTHON_VERSION AMENT_PREFIX_PATH COLCON_PREFIX_PATH CMAKE_PREFIX_PATH \
    LD_LIBRARY_PATH RMW_IMPLEMENTATION PYTHONPATH _ROS_WHEELS_BOOTSTRAP_COMPLETE
}

check_machine() {
  "$base_python" -c 'import ensurepip, venv' &>/dev/null </dev/null ||
    fail "$base_python cannot make virtual environments: Debian and Ubuntu keep that in a package of its own." \
      "Install it: sudo apt install python$("$base_python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')-venv"
  if [[ $kind == pypi && $(uname -sm) != 'Linux x86_64' ]]; then
    fail "ROS 2 exists as wheels for Linux x86_64 only; this is $(uname -sm)." \
      "Install ROS 2, source its setup.bash, and run this again."
  fi
}

# Print what the environment depends on, for a digest: here, the files named, and the Python.
describe() {
  printf '%s\n' "$root" "$name" "$base_python"
  "$base_python" -VV
  cat -- "$@"
}

digest() {
  describe "$@" | sha256sum | cut -d ' ' -f 1
}

pip_install() {
  # Python compiles what is imported when it first is: a third of all files.
  if ! "$venv/bin/python" -m pip --no-input --disable-pip-version-check install --no-compile --progress-bar off \
      --constraint "$constraints" "$@" >>"$log" 2>&1 </dev/null; then
    tail -n 20 -- "$log" >&2
    fail "pip could not install the above. Most often the network or a proxy is in the way." \
      "All that pip said is in $log; the next run begins again."
  fi
}

# With the packages of the kind that is wanted, beside those of runtime.txt.
make_environment() {
  local wheels=() building
  [[ $1 == runtime ]] || wheels=(--requirement "$root/requirements/$1.txt")
  rm -rf -- "$venv"
  mkdir -p -- "$venv"
  touch -- "$venv/.incomplete"
  say "Making a virtual environment for $("$base_python" --version) in .venv/$name"
  if [[ $kind == ros ]]; then
    "$base_python" -m venv --system-site-packages "$venv"
    "$venv/bin/python" "$root/scripts/_prefer_installed.py" "$constraints" > "$venv/constraints.txt"
    constraints=$venv/constraints.txt
  else
    "$base_python" -m venv "$venv"
    if [[ $distribution == jazzy ]]; then
      wheels+=(--requirement "$root/requirements/ros.txt")
    else
      # What is pinned is of Jazzy.
      sed "s/-jazzy-/-$distribution-/" "$root/requirements/ros.txt" > "$venv/ros.txt"
      sed '/^ros-/d; /^-c/d' -- "$constraints" "$requirements/constraints-common.txt" > "$venv/constraints.txt"
      constraints=$venv/constraints.txt
      wheels+=(--requirement "$venv/ros.txt")
    fi
  fi
  # The engine is compiled while the rest is downloaded: it needs no more than these headers.
  pip_install cmeel-eigen
  bring_compiler
  build_engine &
  building=$!
  trap 'kill "$building" 2>/dev/null || true' EXIT
  if [[ $kind == ros ]]; then
    say "Installing what the sourced ROS 2 does not bring: llvmlite, rosbags, mcap (60 MB or more, a minute)"
  else
    say "Installing ROS 2 ($distribution) and the numerics from the Python package index (190 MB, a minute or two)"
  fi
  pip_install --requirement "$root/requirements/runtime.txt" ${wheels[@]+"${wheels[@]}"}
  wait "$building" || fail 'The engine could not be compiled.'
  trap - EXIT
  # Editable: the code that runs is the checkout's.
  pip_install --no-deps --no-build-isolation --editable "$root"
}

build_engine() {
  "$venv/bin/python" -P "$root/closedloop_dynamics/engine/build.py" "$@"
}

# Install a C++ compiler into the environment, where there is none.
bring_compiler() {
  local wheel
  wheel=$(build_engine --requirements)
  if [[ -n $wheel ]]; then
    say "No C++ compiler is on the PATH: installing $wheel (100 MB; its first use takes a minute)"
    pip_install "$wheel"
  fi
}

# Make the environment of a script that does not run the package: what is in requirements/NAME.txt alone.
use_tools() {
  local requirements=$root/requirements constraints=$root/requirements/constraints.txt log=$root/.venv/$1.log key
  unset PYTHONHOME PIP_TARGET PIP_PREFIX PYTHONPATH
  export PYTHONNOUSERSITE=1 PIP_USER=0 ZIG_GLOBAL_CACHE_DIR=${ZIG_GLOBAL_CACHE_DIR:-$root/.cache/zig}
  name=$1 venv=$root/.venv/$1
  find_any_python
  base_python=$("$base_python" -c 'import os, sys; print(os.path.realpath(sys._base_executable))')
  key=$(digest "$requirements"/{"$1",constraints,constraints-common}.txt)
  if [[ $(cat -- "$venv/.key" 2>/dev/null) != "$key" ]]; then
    rm -rf -- "$venv"
    "$base_python" -m venv "$venv"
    say "Installing what is in requirements/$1.txt into .venv/$1"
    pip_install --requirement "$requirements/$1.txt"
    printf '%s\n' "$key" > "$venv/.key"
  fi
}

# Bring the environment up to date: runtime alone, or with what the tests or the documentation need.
update_environment() {
  local wanted=$1 log=$root/.venv/$name.log requirements=$root/requirements constraints runtime_key wanted_key
  constraints=$requirements/constraints${VERSIONS:+-$VERSIONS}.txt
  [[ $kind == pypi ]] || constraints=$requirements/constraints-ubuntu-24.04.txt
  [[ -e $constraints ]] || fail "VERSIONS=$VERSIONS is unknown: there is no ${constraints#"$root"/}."
  runtime_key=$(digest "$requirements"/{runtime,ros,constraints*}.txt "$root"/{pyproject.toml,setup.py,setup.cfg})
  wanted_key=$(digest "$requirements"/*.txt)
  if [[ -e $venv/.incomplete ]] || [[ $(cat -- "$venv/.runtime" 2>/dev/null) != "$runtime_key" ]] ||
      ! "$venv/bin/python" -c '' &>/dev/null; then
    : > "$log"
    make_environment "$wanted"
    printf '%s\n' "$runtime_key" > "$venv/.runtime"
    [[ $wanted == runtime ]] || printf '%s\n' "$wanted_key" > "$venv/.$wanted"
    rm -- "$venv/.incomplete"
  fi
  if [[ $wanted != runtime && $(cat -- "$venv/.$wanted" 2>/dev/null) != "$wanted_key" ]]; then
    touch -- "$venv/.incomplete"
    [[ ! -e $venv/constraints.txt ]] || constraints=$venv/constraints.txt
    say "Installing what is in requirements/$wanted.txt (30 to 70 MB)"
    pip_install --requirement "$requirements/$wanted.txt"
    printf '%s\n' "$wanted_key" > "$venv/.$wanted"
    rm -- "$venv/.incomplete"
  fi
  # Its sources may have changed since.
  bring_compiler
  build_engine || fail 'The engine could not be compiled.'
}

# Where programs may write, whatever HOME is; and ROS traffic that stays on this machine, apart from other runs.
export_environment() {
  local cache=$root/.cache
  export VIRTUAL_ENV=$venv PATH=$venv/bin:$PATH PYTHONPATH=$root${PYTHONPATH:+:$PYTHONPATH}
  # What Python compiles is kept: many processes import the same sources.
  unset PYTHONDONTWRITEBYTECODE
  export MPLCONFIGDIR=${MPLCONFIGDIR:-$cache/matplotlib}
  # Generated code goes to the user's cache, whoever generates it; where there is none, here.
  if [[ -z ${CLOSEDLOOP_CACHE_DIR:-} ]] && ! mkdir -p -- "${XDG_CACHE_HOME:-${HOME:-}/.cache}/closedloop_dynamics" 2>/dev/null; then
    export CLOSEDLOOP_CACHE_DIR=$cache
  fi
  export ROS_LOG_DIR=${ROS_LOG_DIR:-$cache/ros_log}
  export ROS_AUTOMATIC_DISCOVERY_RANGE=${ROS_AUTOMATIC_DISCOVERY_RANGE:-LOCALHOST}
  # Linux has free ports for domains 0 to 101; 0 is everyone's.
  export ROS_DOMAIN_ID=${ROS_DOMAIN_ID:-$((1 + $$ % 101))}
  mkdir -p -- "$MPLCONFIGDIR" "$ROS_LOG_DIR"
}

use_environment() {
  local lock
  # Settings of other environments, and packages of the user's own, must not leak in.
  unset PYTHONHOME PIP_TARGET PIP_PREFIX
  export PYTHONNOUSERSITE=1 PIP_USER=0
  # What the compiler ziglang makes of its own libraries.
  export ZIG_GLOBAL_CACHE_DIR=${ZIG_GLOBAL_CACHE_DIR:-$root/.cache/zig}
  choose_kind
  check_machine
  venv=$root/.venv/$name
  mkdir -p -- "$root/.venv"
  exec {lock}>"$root/.venv/lock"
  if ! flock --nonblock "$lock"; then
    say 'Waiting for another run that sets up its environment'
    flock "$lock"
  fi
  update_environment "$1"
  ln -sfn -- "$name/bin/activate" "$root/.venv/activate"
  exec {lock}>&-
  export_environment
}
