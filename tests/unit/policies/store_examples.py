"""A small ring and policies for the tests of the store."""

from itertools import pairwise

import numpy as np

from orbitfb.core.signals import Channels
from orbitfb.policies.modal import ModalPolicy, ModalSettings
from orbitfb.policies.network import NetworkPolicy, network_sizes
from orbitfb.policies.svd import SvdPolicy, SvdSettings


def ring(bpms=5, correctors=4, planes="x", prefix=""):
    names = tuple(f"{prefix}BPM{i}" for i in range(bpms))
    magnets = tuple(f"{prefix}COR{i}" for i in range(correctors))
    return Channels(planes, names, magnets, names, magnets, magnets)


def make_policy(seed=0, bpms=5, correctors=4, **chosen):
    rng = np.random.default_rng(seed)
    return SvdPolicy(1e-3 * rng.normal(size=(bpms, correctors)), SvdSettings(**chosen))


def make_modal(seed=0, bpms=5, correctors=4, **chosen):
    rng = np.random.default_rng(seed)
    response = 1e-3 * rng.normal(size=(bpms, correctors))
    root = 1e-4 * rng.normal(size=(correctors, correctors))
    return ModalPolicy(response, ModalSettings(**chosen), covariance=root @ root.T)


def make_network(seed=0, bpms=5, correctors=4):
    rng = np.random.default_rng(seed)
    sizes = network_sizes(bpms, correctors)
    weights = [
        rng.normal(size=(after, before)).astype(np.float32) / np.sqrt(before)
        for before, after in pairwise(sizes)
    ]
    return NetworkPolicy(weights, 1e-3 * rng.normal(size=(bpms, correctors)))
