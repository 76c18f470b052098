"""What a run leaves behind: result files, figures."""
