"""How kernels are compiled, kept, and made to carry nothing that a scene does not have."""
