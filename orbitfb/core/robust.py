"""The scatter of numbers of which a few are wild."""

TO_SIGMA = 1.4826
"""Standard deviation of normal numbers over the median of their sizes [1]: 1 / Φ⁻¹(3/4)."""
