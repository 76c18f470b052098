"""PoseDiffusion (Wang, Rupprecht and Novotny, ICCV 2023), as PyTorch modules.

Pictures are cropped (`crop`) and become one feature each (`encoder`); from noise, a denoiser (`denoiser`) makes pose
vectors (`pose`) that fit the features, step by step of a schedule (`schedule`); matches guide the last steps
(`guidance`). `model` puts them together. Names of parameters are those of the published checkpoints.
"""
