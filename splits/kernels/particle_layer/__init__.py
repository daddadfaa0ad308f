"""Layers of small particles under smooth or rough surfaces, with next-event estimation."""
