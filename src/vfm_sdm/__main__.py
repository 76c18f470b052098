"""``python -m vfm_sdm`` is the command ``vfm-sdm``."""

from vfm_sdm.cli import main

if __name__ == "__main__":
    main()
