"""Numbers that several parts share and nobody should have to type again."""

from typing import Final

__all__ = ["KM_H", "NORMAL_95"]

NORMAL_95: Final = 1.96
"""Standard deviations on either side of the mean within which 95 % of normal errors lie [1]."""
KM_H: Final = 3.6
"""Kilometres an hour of a metre a second [km/h per m/s]."""
