"""Profiles of consumer cameras' lenses: what independent calibrations of a camera and mode let expect of another one.

The table comes with the package (``profiles.csv.gz``, made by ``tools/lens_profiles.py``; its calibrations are under
CC0, see ``LICENSE-profiles``).
"""

from vfm_sdm.inputs.profiles.find import find_camera, find_tagged
from vfm_sdm.inputs.profiles.hierarchy import Expected, LensKey
from vfm_sdm.inputs.profiles.lookup import CROP, LensProfile, expect_any, expect_lens, list_modes
from vfm_sdm.inputs.profiles.words import CameraClass, Setting, aspect_of, read_setting

__all__ = [
    "CROP",
    "CameraClass",
    "Expected",
    "LensKey",
    "LensProfile",
    "Setting",
    "aspect_of",
    "expect_any",
    "expect_lens",
    "find_camera",
    "find_tagged",
    "list_modes",
    "read_setting",
]
