"""vfm-sdm: structural displacement in millimetres from two ordinary cameras and one measured length.

The public names stand in ``__init__.pyi``, and each is imported when it is first asked for: ``import vfm_sdm`` alone
costs nothing.
"""

import lazy_loader

__version__ = "0.1.0"

__getattr__, __dir__, _names = lazy_loader.attach_stub(__name__, __file__)
__all__ = [*_names, "__version__"]  # noqa: PLE0604  (ruff does not see that these are strings)
