"""The configuration of experiments and studies: models, checks, loading."""
