"""The compiled recurrence is torch's, in value and in gradient."""

import numpy as np
import pytest
import torch

from surefoot.models.observer.architectures import GRU
from surefoot.models.observer.gru import tanh
from surefoot.models.observer.inference import cholesky_factor
from surefoot.models.observer.network import loss_of

torch.set_num_threads(1)


def test_values_and_gradients_are_those_of_torch():
    torch.manual_seed(3)
    reference, ours = torch.nn.GRU(7, 10), GRU(7, 10)
    ours.load_state_dict(reference.state_dict())
    x = torch.randn(60, 3, 7)
    weight = torch.randn(60, 3, 10)
    results = []
    for layer in (reference, ours):
        inputs = x.clone().requires_grad_()
        out = layer(inputs)[0] if layer is reference else layer(inputs)
        (out * weight).sum().backward()
        grads = [p.grad for _, p in sorted(layer.named_parameters())]
        results.append([out.detach(), inputs.grad, *grads])
    for theirs, mine in zip(*results, strict=True):
        torch.testing.assert_close(mine, theirs, rtol=2e-5, atol=2e-5)


def test_tanh_keeps_its_promise():
    x = np.linspace(-12, 12, 20001).astype(np.float32)
    ours = np.array([tanh.py_func(v) for v in x])
    assert np.abs(ours - np.tanh(x.astype(float))).max() < 3e-7


def test_gaussian_loss_is_the_density_of_scipy():
    from scipy.stats import multivariate_normal

    torch.manual_seed(0)
    outputs, target = torch.randn(20, 9).double(), torch.randn(20, 3).double()
    L = cholesky_factor(outputs.numpy())
    ours = loss_of("gml", outputs, target).numpy() + 1.5 * np.log(2 * np.pi)
    for i in range(20):
        law = multivariate_normal(outputs[i, :3].numpy(), L[i] @ L[i].T)
        assert ours[i] == pytest.approx(-law.logpdf(target[i].numpy()), rel=1e-9)


def test_covariances_are_positive_definite_for_any_output():
    L = cholesky_factor(50 * np.random.default_rng(1).standard_normal((500, 9)))
    assert np.diagonal(L, axis1=-2, axis2=-1).min() >= 1e-3
    assert np.array_equal(L, np.tril(L))
