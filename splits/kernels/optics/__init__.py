"""What light does at faces and at single particles, polarised or not, and where it comes from."""
