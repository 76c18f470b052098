"""TAPIR and BootsTAPIR: any point of a video followed through all its frames.

The network compares the feature of a query point with a coarse feature grid of every frame (``initialization``), then
refines position, occlusion and uncertainty with a temporal mixer that looks at local correlations (``refinement``,
``mixer``). ``model`` puts the parts together. Every module here but ``config`` needs torch; importing this package
does not.

References
----------
Doersch et al., "TAPIR: Tracking Any Point with per-frame Initialization and temporal Refinement", ICCV 2023.
Doersch et al., "BootsTAP: Bootstrapped Training for Tracking-Any-Point", 2024.
"""

__all__: list[str] = []
