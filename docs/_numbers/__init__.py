"""Numbers and images that README and docs take from a run."""
