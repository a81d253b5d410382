#!/usr/bin/env bash
# Everything that `make demo` and `make test` need: system libraries, .venv with the pinned packages, compiled kernels.
# Does nothing when all of it is there. A setup that was killed is done again from the start.
set -eu -o pipefail
cd "$(dirname "$0")/.."

say() { printf 'setup: %s\n' "$*"; }
fail() { printf 'setup: %s\n' "$*" >&2; exit 1; }

# Two runs at once would take each other's .venv away.
if command -v flock >/dev/null; then
  exec 9<scripts/setup.sh
  flock -n 9 || { say "waiting for another setup in this folder"; flock 9; }
fi

find_python() {
  local name
  for name in python3 python3.12 python3.11 python3.13 python3.14; do
    if "$name" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
      echo "$name"
      return
    fi
  done
  fail "needs Python 3.11 or newer, and found none; install python3.11 or python3.12 and try again"
}

# Packages that are missing, by the shared library or module each is needed for.
missing_packages() {
  "$1" -c 'import ensurepip, venv' 2>/dev/null || echo "$1-venv"
  [ "$(uname -s)" = Linux ] || return 0
  local libraries pair
  libraries=$(PATH="$PATH:/usr/sbin:/sbin" ldconfig -p 2>/dev/null || true)
  [ -n "$libraries" ] || return 0
  for pair in libusb-1.0-0=libusb-1.0.so.0 libgl1=libGL.so.1 libegl1=libEGL.so.1 \
    libgomp1=libgomp.so.1 libx11-6=libX11.so.6 libudev1=libudev.so.1 libidn2-0=libidn2.so.0; do
    case "$libraries" in *"${pair#*=} "*) ;; *) echo "${pair%%=*}" ;; esac
  done
}

install_packages() {
  local as_root=() log wait=(-o DPkg::Lock::Timeout=300) # another apt-get may be running
  command -v apt-get >/dev/null || fail "missing system packages (Debian's names): $*; install them and try again"
  if [ "$(id -u)" -ne 0 ]; then
    sudo -n true 2>/dev/null || fail "missing system packages; run: sudo apt-get install -y $*"
    as_root=(sudo -n)
  fi
  say "installing system packages: $*"
  log=$(mktemp)
  if ! { ${as_root[@]+"${as_root[@]}"} apt-get "${wait[@]}" update -qq &&
    ${as_root[@]+"${as_root[@]}"} env DEBIAN_FRONTEND=noninteractive \
      apt-get "${wait[@]}" install -y -qq --no-install-recommends "$@"; } >"$log" 2>&1; then
    tail -n 5 "$log" >&2
    rm -f "$log"
    fail "apt-get could not install: $*; its last words are above"
  fi
  rm -f "$log"
}

# torch, which the tests of networks need, without CUDA's libraries: 0.2 GB to download in place of some GB. On Linux
# that build has a version of its own, found where pip looks; elsewhere it is the usual one.
install_torch() {
  local version
  version=$(sed -n 's/^torch==//p' constraints.txt)
  [ "$(uname -s)" != Linux ] || version+=+cpu
  .venv/bin/python -m pip install -qq --disable-pip-version-check -c constraints.txt "torch==$version"
}

# A line every half minute, as long as this script runs.
tell_time() {
  local next=30
  while sleep 1 && kill -0 $$ 2>/dev/null; do
    if [ "$SECONDS" -ge "$next" ]; then
      say "still installing, $SECONDS s"
      next=$((SECONDS + 30))
    fi
  done
}

python=$(find_python)
mapfile -t missing < <(missing_packages "$python")
[ ${#missing[@]} -eq 0 ] || install_packages "${missing[@]}"

# Line 1: where .venv was made and by which Python. Line 2: what was installed into it.
stamp=.venv/kinectbench-setup
place="$PWD $("$python" -c 'import sys; print(sys.version.split()[0])')"
wanted=$(cat pyproject.toml benchmarks/plugins/pyproject.toml constraints.txt | sha256sum | cut -d ' ' -f 1)
if [ "$(sed -n 1p "$stamp" 2>/dev/null)" != "$place" ] || ! .venv/bin/python -c '' 2>/dev/null; then
  if [ -e .venv ] || [ -L .venv ]; then
    say "removing a .venv that is unfinished or was made elsewhere"
    rm -rf .venv
  fi
  say "making .venv with $("$python" --version)"
  "$python" -m venv .venv || fail "cannot make .venv with $python"
elif [ "$(sed -n 2p "$stamp")" = "$wanted" ]; then
  say "up to date"
  exit 0
fi
rm -f "$stamp"
say "installing the pinned packages (about 3 GB on disk; some minutes the first time)"
tell_time 9>&- &
trap "kill $! 2>/dev/null || true" EXIT
.venv/bin/python -m pip install -qq --disable-pip-version-check -c constraints.txt -e '.[dev,docs]' \
  -e benchmarks/plugins ||
  fail "the packages could not be installed; pip's reason is above"
install_torch || say "torch for CPUs could not be installed, pip's reason is above: the tests of networks are left out"
say "compiling the kernels (a minute or two)"
.venv/bin/python scripts/compile_kernels.py || say "not all kernels were compiled, as said above; the first build does it"
printf '%s\n%s\n' "$place" "$wanted" >"$stamp"
say "done"
