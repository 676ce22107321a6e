"""Walks: in batches, as an environment, in the style of a measured one, with a radar; and their
truth.
"""
