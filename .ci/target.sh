#!/usr/bin/env bash
# Run Python with the arithmetic of another processor: kernels, numpy and BLAS take the instructions of a named target and not those of this machine.
#   .ci/target.sh generic|x86-64-v2|x86-64-v3|skylake-avx512 PYTHON ARGUMENTS...
set -euo pipefail
target=$1 python=$2
features() { "$python" -c 'import numpy._core._multiarray_umath as m; print(*m.__cpu_dispatch__)' | tr ' ' '\n' | grep -E "$1" | tr '\n' ' '; }
case $target in
  generic) kernels= beyond=. blas=Prescott ;;
  x86-64-v2) kernels=+sse3,+ssse3,+sse4.1,+sse4.2,+popcnt,+cx16 beyond=. blas=Nehalem ;;
  x86-64-v3) kernels=+sse4.2,+popcnt,+avx,+avx2,+fma,+bmi,+bmi2,+lzcnt,+f16c,+movbe beyond='AVX512|V4' blas=Haswell ;;
  skylake-avx512) kernels=+sse4.2,+popcnt,+avx,+avx2,+fma,+bmi,+bmi2,+lzcnt,+f16c,+movbe,+avx512f,+avx512bw,+avx512cd,+avx512dq,+avx512vl beyond='ICL|SPR' blas=SkylakeX ;;
  *) echo "unknown target $target" >&2 && exit 2 ;;
esac
NPY_DISABLE_CPU_FEATURES=$(features "$beyond")
export NPY_DISABLE_CPU_FEATURES NUMBA_CPU_NAME=$target NUMBA_CPU_FEATURES=$kernels OPENBLAS_CORETYPE=$blas
export NUMBA_CACHE_DIR=${NUMBA_CACHE_DIR:-$PWD/.kernels/$target} OPENBLAS_NUM_THREADS=1
exec "${@:2}"
