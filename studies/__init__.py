"""Studies with surefoot, run from a checkout by `make study-*`; they are part of no wheel."""
