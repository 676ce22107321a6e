"""MuJoCo: the scene, the compiled stepper, and inverse dynamics."""
