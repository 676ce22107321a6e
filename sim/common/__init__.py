"""Used by all packages: errors, files, quaternions, sources and compiled kernels."""
