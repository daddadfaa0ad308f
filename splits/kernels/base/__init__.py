"""Scenes, sampling rules, rays and work: the data that both kernels share."""
