"""MuJoCo: scene, compiled stepper, and inverse dynamics."""
