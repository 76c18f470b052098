import subprocess
import sys

import vfm_sdm


def test_every_public_name_is_there():
    for name in vfm_sdm.__all__:
        assert getattr(vfm_sdm, name) is not None


def test_unknown_names_are_attribute_errors():
    assert not hasattr(vfm_sdm, "mesure")


def test_importing_has_no_heavy_side_effect():
    code = "import sys, vfm_sdm; print(sorted({'torch', 'numba', 'cv2', 'av', 'matplotlib'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"
