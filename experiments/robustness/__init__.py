"""One motion under thousands of perturbed trials: the trials, their store on disk, statistics, `robustness.json`."""
