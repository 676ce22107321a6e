"""Models from data: the velocity observer, its calibration, residuals and their causes."""
