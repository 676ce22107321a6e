"""What every room needs: errors, files, quaternions, sources and compiled kernels."""
