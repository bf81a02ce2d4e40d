# SPDX-License-Identifier: GPL-3.0-or-later
"""Adam for a field with a varying number of Gaussians; rows of invisible Gaussians are not updated."""

from __future__ import annotations

from dataclasses import fields

import torch
from torch import Tensor

from mgf_engine.model.gaussians import Gaussians
from mgf_engine.raster.adam import AdamStep, adam_step

TRAINED = ("positions", "log_scales", "rotations", "opacity_logits", "sh")


class Optimiser:
    """Holds the field and Adam's two moments per trained parameter.

    Attributes:
        field: the parameters; another object after :meth:`keep` and :meth:`append`.
        moments: name -> (first, second), each shaped like the parameter.
        step_count: steps taken so far, for the bias correction.
    """

    def __init__(self, field: Gaussians) -> None:
        self.field = field
        self.moments = {n: (torch.zeros_like(getattr(field, n)), torch.zeros_like(getattr(field, n))) for n in TRAINED}
        self.step_count = 0

    def to(self, device: torch.device) -> Optimiser:
        """Return the same on a device."""
        moved = Optimiser(self.field.to(device))
        moved.moments = {name: (a.to(device), b.to(device)) for name, (a, b) in self.moments.items()}
        moved.step_count = self.step_count
        return moved

    def leaves(self) -> Gaussians:
        """Return the field with gradients switched on, to render and differentiate."""
        for name in TRAINED:
            getattr(self.field, name).requires_grad_(True).grad = None
        return self.field

    def step(self, rates: dict[str, float], visible: Tensor, sh_rest_share: float) -> None:
        """Take one Adam step from the gradients on the leaves.

        Args:
            rates: learning rate per parameter name.
            visible: bool [N]; other rows keep their values and moments.
            sh_rest_share: learning rate of the view-dependent colour as a share of the constant one's.
        """
        self.step_count += 1
        for name in TRAINED:
            parameter = getattr(self.field, name)
            gradient = parameter.grad
            parameter.grad = None
            parameter.requires_grad_(False)
            if gradient is None:
                continue
            columns = parameter[0].numel()
            scale = torch.full((columns,), rates[name])
            if name == "sh":
                scale[3:] *= sh_rest_share
            adam_step(parameter, gradient, self.moments[name], AdamStep(scale, self.step_count), visible)

    def keep(self, index: Tensor) -> None:
        """Drop every row not in ``index`` (bool mask or int64 indices)."""
        for name in TRAINED:
            getattr(self.field, name).requires_grad_(False)
        self.field = self.field.select(index)
        self.moments = {n: (a[index].contiguous(), b[index].contiguous()) for n, (a, b) in self.moments.items()}

    def append(self, new: Gaussians) -> None:
        """Add rows with empty moments."""
        joined = {f.name: torch.cat([getattr(self.field, f.name), getattr(new, f.name)]) for f in fields(Gaussians)}
        self.field = Gaussians(**joined)
        for name, (first, second) in self.moments.items():
            zeros = torch.zeros_like(getattr(new, name))
            self.moments[name] = (torch.cat([first, zeros]), torch.cat([second, zeros]))
