"""Attribution of a residual to the effects that a robot's model lacks."""
