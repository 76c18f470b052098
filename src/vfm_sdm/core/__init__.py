"""What every part stands on: arrays, datasets, statuses, files, the registry of interchangeable parts."""
