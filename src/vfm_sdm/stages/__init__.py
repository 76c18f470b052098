"""The steps of the paper, one folder each; a step knows only those below it."""
