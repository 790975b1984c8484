"""Many settings tried: which, in what order, each as a run, and what came of them."""
