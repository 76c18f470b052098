"""VGGT, the visual geometry grounded transformer (Wang et al., CVPR 2025), as PyTorch modules.

Frames become tokens (`encoder`), attend within and across frames (`aggregator`), and give cameras (`camera_head`,
`pose`) or a feature map (`feature_head`) in which points are followed (`tracker`, `updates`). `model` puts them
together. Names of parameters are those of the published checkpoints.
"""
