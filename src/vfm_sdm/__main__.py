"""``python -m vfm_sdm`` is the command ``vfm-sdm``."""

from vfm_sdm.commands.app import main

if __name__ == "__main__":
    main()
