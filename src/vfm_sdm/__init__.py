"""vfm-sdm: structural displacement in millimetres from two ordinary cameras and one measured length."""

__version__ = "0.1.0"
__all__ = ["__version__"]
