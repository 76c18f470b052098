"""Prints, a line each, the environment in which libraries compute here as on an older processor.

Rounding differs from processor to processor: sums run in vectors of other lengths, with or without fused multiplication
and addition, and a matrix product takes another kernel. What each library may use is asked of the library itself: names
differ between versions, and some are refused where the processor or the build does not have them.
"""

import platform

import cv2
from numpy._core import _multiarray_umath as numpy_core


def numpy_features() -> list[str]:
    """What NumPy's loops are chosen by here, beyond what it cannot do without."""
    return [name for name in numpy_core.__cpu_dispatch__ if numpy_core.__cpu_features__.get(name)]


def opencv_features() -> list[str]:
    """The same of OpenCV: a star marks what is chosen when it runs, a question mark what is not here."""
    names = cv2.getCPUFeaturesLine().split()
    return [name.removeprefix("*") for name in names if name.startswith("*") and not name.endswith("?")]


def environment() -> dict[str, str]:
    """Variables that the libraries read when they are loaded."""
    arm = platform.machine().lower() in ("aarch64", "arm64")
    return {
        "VFM_SDM_ANOTHER_PROCESSOR": "1",
        "NPY_DISABLE_CPU_FEATURES": " ".join(numpy_features()),
        "OPENCV_CPU_DISABLE": ",".join(opencv_features()),
        "OPENBLAS_CORETYPE": "ARMV8" if arm else "Nehalem",  # of NumPy, and of SciPy
        "NUMBA_CPU_NAME": "generic",
        "ATEN_CPU_CAPABILITY": "default",  # PyTorch's own loops
        "ONEDNN_MAX_CPU_ISA": "SSE41",  # its convolutions and matrix products; no effect on Arm
        "MKL_CBWR": "COMPATIBLE",
    }


if __name__ == "__main__":
    print(*(f"{name}={value}" for name, value in environment().items()), sep="\n")
