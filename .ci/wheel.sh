#!/usr/bin/env bash
# The built wheel in an empty environment, away from the checkout: it brings its kernels compiled, the shipped scenarios travel with it, and a
# first scenario runs. The tested wheel goes to dist/.
#   .ci/wheel.sh [PYTHON [PROCESSOR ...]]     PYTHON, which has the package's dependencies, compiles the kernels (default python3) for its own
#                                             baseline or the processors (x86-64-v3, generic), and makes the environment
set -euo pipefail
root=$(cd "$(dirname "$0")/.." && pwd)
python=$(command -v "${1:-python3}")
work=$(mktemp -d)
trap 'status=$?; rm -rf "$work"; [ $status = 0 ] || echo "wheel: FAILED at: $BASH_COMMAND" >&2' EXIT
export MPLBACKEND=Agg
PYTHONPATH=$root "$python" "$root/.ci/kernels.py" "$work/kernels" "${@:2}"
unset PYTHONPATH
"$python" -m venv "$work/venv"
INSEMU_KERNELS=$work/kernels "$work/venv/bin/python" -m pip wheel --quiet --disable-pip-version-check --no-deps --wheel-dir "$work" "$root"
"$work/venv/bin/python" -m pip install --quiet --disable-pip-version-check --no-compile --constraint "$root/constraints.txt" "$work"/insemu-*.whl
cd "$work"
insemu=$work/venv/bin/insemu
"$work/venv/bin/python" -c 'import sys, insemu; sys.exit(None if insemu.__file__.startswith(sys.prefix) else f"found {insemu.__file__}")'
"$insemu" --version | grep 'kernels: shipped for'
# What has to be compiled where the wheel runs would be kept here.
export NUMBA_CACHE_DIR=$work/compiled
"$work/venv/bin/python" -c '
import numpy as np
rng = np.random.default_rng(1)
np.savez("log.npz", data=1e-3 * rng.standard_normal((100_000, 2)), fs=100.0, columns=["gyro_x", "accel_x"], units=["rad/s", "m/s^2"])'
"$insemu" fit log.npz --model "2*GM() + WN()" > fit.txt
"$insemu" run table3_synthetic --realizations 2 --output table3 > table3.txt
if [ -n "$(find "$NUMBA_CACHE_DIR" -name '*.nb[ic]' 2> /dev/null)" ]; then
  find "$NUMBA_CACHE_DIR" -name '*.nbi' -printf 'wheel: compiled here: %f\n' >&2
  false "kernels are missing from the wheel"
fi
unset NUMBA_CACHE_DIR
"$work/venv/bin/python" "$root/.ci/agreement.py"
"$insemu" init --list > list.txt
grep -q '^table3_synthetic:' list.txt
"$insemu" sensor ADIS16470 > sensor.txt
grep -q '8 deg/h' sensor.txt
"$insemu" init --sensor ADIS16470 my.yaml
"$insemu" run my.yaml --realizations 2 --workers 2 --output my
test -s my/index.html
"$insemu" init --like outages_smoothed
test -s motion/roundabout_and_road.csv
"$insemu" designs --scenario table_6_denoising > /dev/null
mkdir -p "$root/dist"
cp "$work"/insemu-*.whl "$root/dist"
echo "wheel: $(basename "$work"/insemu-*.whl) works in an empty environment, now in dist/"
