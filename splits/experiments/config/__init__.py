"""Configuration of experiments and studies: models, validation and loading."""
