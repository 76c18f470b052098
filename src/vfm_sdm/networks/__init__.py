"""Neural architectures as PyTorch modules of our own; torch is imported by their modules only."""
