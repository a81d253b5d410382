#!/usr/bin/env bash
# Builds the wheel, installs it alone into a clean environment, and loads, checks and scores with it there.
#   scripts/try_wheel.sh [RELEASE]   with a published folder: its baseline `partial` is scored, too
set -eu -o pipefail
release=${1:+$(realpath "$1")}
here=$(cd "$(dirname "$0")/.." && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
say() { printf 'wheel: %s\n' "$*"; }

python3 -m venv "$work/venv"
pip() { "$work/venv/bin/python" -m pip -q --disable-pip-version-check "$@"; }
# From a copy, as a build leaves folders beside the source.
git -C "$here" archive HEAD | tar -x -C "$work" --one-top-level=source
pip wheel --no-deps -w "$work/dist" "$work/source"
began=$SECONDS
pip install -c "$here/constraints.txt" "$work"/dist/*.whl
say "$(basename "$work"/dist/*.whl), $(du -sm "$work"/dist/*.whl | cut -f1) MB; installed in $((SECONDS - began)) s"
pip uninstall -y setuptools pip >/dev/null 2>&1 || true
say "$(du -sm "$work/venv" | cut -f1) MB with all it needs"

cd "$work"
PATH="$work/venv/bin:$PATH"
kinectbench --version
python -c 'import kinectbench; print(kinectbench.load.__doc__.splitlines()[0])'
status=0
said=$(kinectbench build 2>&1) || status=$?
[ "$status" -eq 2 ] && case "$said" in *"kinectbench[build]"*) ;; *) status=0 ;; esac
[ "$status" -eq 2 ] || { say "build without its extra said: $said"; exit 1; }
if [ -n "$release" ]; then
  kinectbench verify "$release"
  kinectbench baseline partial --benchmark "$release" --out predictions
  kinectbench score predictions/partial --benchmark "$release" --out scores --no-baselines >/dev/null
fi
say "well"
