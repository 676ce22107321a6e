"""The loop closed: a trace, its report, and what the effect found does to simulation."""
