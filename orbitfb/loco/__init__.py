"""Fit and diagnosis of a measured orbit response matrix (LOCO with evidence, names, open answer).

`measured` is what was measured, `optics` the response of the table with gradient errors, `normal`
the normal equations, `fit` the Gauss-Newton fit, `coupling` that of the cross blocks, `screen` what
is wrong before any fit, `names` the devices that stand out.
"""
