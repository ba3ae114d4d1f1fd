#!/usr/bin/env bash
# The built wheel in an empty environment, away from the checkout: the shipped scenarios travel with it, and a first scenario runs.
#   .ci/wheel.sh [PYTHON]     PYTHON makes the environment (default python3)
set -euo pipefail
root=$(cd "$(dirname "$0")/.." && pwd)
python=$(command -v "${1:-python3}")
work=$(mktemp -d)
trap 'status=$?; rm -rf "$work"; [ $status = 0 ] || echo "wheel: FAILED at: $BASH_COMMAND" >&2' EXIT
unset PYTHONPATH
export MPLBACKEND=Agg
"$python" -m venv "$work/venv"
"$work/venv/bin/python" -m pip wheel --quiet --disable-pip-version-check --no-deps --wheel-dir "$work" "$root"
"$work/venv/bin/python" -m pip install --quiet --disable-pip-version-check --constraint "$root/constraints.txt" "$work"/insemu-*.whl
# Kernels that the checkout compiled serve the same source: numba asks for its size and time (two minutes of a core).
installed=$("$work/venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
(cd "$root" && find insemu -name '*.nbi' -printf '%h\n' | sort -u) | while read -r cache; do
  for source in "$root/${cache%/__pycache__}"/*.py; do
    there=$installed/${source#"$root"/}
    cmp --quiet "$source" "$there" && touch --reference="$source" "$there"
  done
  mkdir -p "$installed/$cache" && cp "$root/$cache"/*.nb[ic] "$installed/$cache"
done
[ ! -f "$root/insemu/__pycache__/kernels.stamp" ] || cp "$root/insemu/__pycache__/kernels.stamp" "$installed/insemu/__pycache__"
cd "$work"
insemu=$work/venv/bin/insemu
"$work/venv/bin/python" -c 'import sys, insemu; sys.exit(None if insemu.__file__.startswith(sys.prefix) else f"found {insemu.__file__}")'
"$insemu" init --list > list.txt
grep -q '^table3_synthetic:' list.txt
"$insemu" sensor ADIS16470 > sensor.txt
grep -q '8 deg/h' sensor.txt
"$insemu" init --sensor ADIS16470 my.yaml
"$insemu" run my.yaml --realizations 2 --workers 2 --out my
test -s my/index.html
"$insemu" init --like outages_smoothed
test -s motion/roundabout_and_road.csv
"$insemu" designs --scenario table_6_denoising > /dev/null
echo "wheel: $(basename "$work"/insemu-*.whl) works in an empty environment"
