"""Where CI pretends to be an older processor (`.ci/another_processor.py`): every library that computes believes it."""

import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.skipif(
    "VFM_SDM_ANOTHER_PROCESSOR" not in os.environ, reason="computes as this processor can; .ci/run pretends another one"
)


def test_numpy_uses_no_more_than_it_cannot_do_without():
    from numpy._core import _multiarray_umath as core

    assert [name for name in core.__cpu_dispatch__ if core.__cpu_features__.get(name)] == []


def test_matrix_products_of_numpy_and_scipy_are_those_of_the_oldest_kernels():
    import numpy  # noqa: F401
    import scipy.linalg  # noqa: F401
    from threadpoolctl import threadpool_info

    kernels = [one["architecture"].lower() for one in threadpool_info() if one["internal_api"] == "openblas"]
    assert {kernel == os.environ["OPENBLAS_CORETYPE"].lower() for kernel in kernels} <= {True}, kernels


def test_numba_compiles_for_any_processor():
    from numba.core.registry import cpu_target

    _, name, features = cpu_target.target_context.codegen().magic_tuple()
    assert (name, features) == ("generic", "")


def test_opencv_chooses_nothing():
    import cv2

    chosen = [name for name in cv2.getCPUFeaturesLine().split() if name.startswith("*") and not name.endswith("?")]
    assert chosen == []


def test_pytorch_uses_neither_long_vectors_nor_their_kernels():
    torch = pytest.importorskip("torch")
    assert torch.backends.cpu.get_cpu_capability() in ("DEFAULT", "NO AVX")
    if not torch.backends.mkldnn.is_available():
        return
    code = "import torch; torch.nn.functional.conv2d(torch.ones(4, 16, 64, 64), torch.ones(16, 16, 3, 3))"
    told = {**os.environ, "ONEDNN_VERBOSE": "1"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=told)
    assert "cpu,isa:" in done.stdout
    assert "AVX" not in done.stdout.upper()
