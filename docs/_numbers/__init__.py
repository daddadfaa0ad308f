"""Numbers and images of README and docs, generated from a run."""
