# SPDX-License-Identifier: GPL-3.0-or-later
"""Reference of the rasterizer in plain float64 torch: every Gaussian at every pixel, gradients by autograd.

It follows the same rules as the kernels (see :mod:`mgf_engine.raster.api`) but none of their rewriting: it inverts the
covariance, finds the point of largest response on each ray, and measures its distance to the centre as a vector. Memory
is Gaussians times pixels; it is for tests and small pictures.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor

from mgf_engine.model.gaussians import Gaussians
from mgf_engine.raster.camera import TILE, Camera
from mgf_engine.raster.outputs import Rendering, RenderStats

T_STOP, ALPHA_MAX, ALPHA_MIN = 1e-4, 0.99, 1.0 / 255.0
LOG_SCALE_MIN, LOG_SCALE_MAX = math.log(1e-6), math.log(1e3)
CENTRE_LIMIT = 1e5  # pixels


@dataclass
class Projected:
    """N Gaussians in a camera's frame, float64.

    Attributes:
        centre: [N, 3], camera frame; ``depth`` [N] is its last column, or 1 where it is not drawn.
        pixel: [N, 2], projected centre.
        precision: [N, 3, 3], inverse covariance in the camera frame.
        opacity: [N]; ``rgb`` [N, 3]; ``normal`` [N, 3] (camera frame, facing the camera).
        drawn: bool [N], true for Gaussians that may be drawn at all.
    """

    centre: Tensor
    depth: Tensor
    pixel: Tensor
    precision: Tensor
    opacity: Tensor
    rgb: Tensor
    normal: Tensor
    drawn: Tensor


@dataclass
class Responses:
    """N Gaussians at P pixels, front to back.

    Attributes:
        order: int64 [N], which Gaussian each row is.
        free: [N, P], opacity * exp(power) before any rule; ``t`` [N, P], depth of the largest response.
        before: [N, P], transmittance before each; ``weight`` [N, P].
    """

    order: Tensor
    free: Tensor
    t: Tensor
    before: Tensor
    weight: Tensor


def rotation_matrices(quaternions: Tensor) -> Tensor:
    """Convert quaternions (w, x, y, z) [N, 4] of any length to rotation matrices [N, 3, 3]; no length, no rotation."""
    squared = (quaternions**2).sum(1, keepdim=True)
    usable = (squared > 1e-24) & (squared < 1e24)
    identity = quaternions.new_tensor([1.0, 0.0, 0.0, 0.0])
    unit = torch.where(usable, quaternions, identity) / torch.sqrt(torch.where(usable, squared, 1.0))
    w, x, y, z = unit.unbind(1)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, 1).view(-1, 3, 3)


def sh_basis(directions: Tensor) -> Tensor:
    """Evaluate the real spherical harmonics of degree 0..3 (Condon-Shortley sign) at unit vectors [N, 3] -> [N, 16]."""
    x, y, z = directions.unbind(-1)
    pi = math.pi
    c1 = math.sqrt(3 / (4 * pi))
    c2, c20 = math.sqrt(15 / (4 * pi)), math.sqrt(5 / (16 * pi))
    c33, c32, c31, c30 = (
        math.sqrt(35 / (32 * pi)), math.sqrt(105 / (4 * pi)), math.sqrt(21 / (32 * pi)), math.sqrt(7 / (16 * pi)),
    )  # fmt: skip
    values = [
        torch.full_like(x, math.sqrt(1 / (4 * pi))),
        -c1 * y, c1 * z, -c1 * x,
        c2 * x * y, -c2 * y * z, c20 * (2 * z * z - x * x - y * y), -c2 * x * z, c2 / 2 * (x * x - y * y),
        -c33 * y * (3 * x * x - y * y), c32 * x * y * z, -c31 * y * (4 * z * z - x * x - y * y),
        c30 * z * (2 * z * z - 3 * x * x - 3 * y * y), -c31 * x * (4 * z * z - x * x - y * y),
        c32 / 2 * z * (x * x - y * y), -c33 * x * (x * x - 3 * y * y),
    ]  # fmt: skip
    return torch.stack(values, -1)


def project(gaussians: Gaussians, camera: Camera, sh_degree: int) -> Projected:
    """Project every Gaussian: centre, precision, opacity, colour and normal as the camera sees it."""
    double = torch.float64
    p, filter_3d = gaussians.positions.to(double), gaussians.filter_3d.to(double)
    view = torch.as_tensor(camera.rotation, dtype=double)
    centre = p @ view.T + torch.as_tensor(camera.translation, dtype=double)
    front = centre[:, 2] > camera.near
    depth = torch.where(front, centre[:, 2], 1.0)
    pixel = centre[:, :2] / depth[:, None] * torch.tensor([camera.fx, camera.fy], dtype=double)
    local = torch.exp(gaussians.log_scales.to(double).clamp(LOG_SCALE_MIN, LOG_SCALE_MAX))
    scales = torch.sqrt(local**2 + filter_3d[:, None] ** 2)
    opacity = torch.sigmoid(gaussians.opacity_logits.to(double)) * (local / scales).prod(1)
    axes = view @ rotation_matrices(gaussians.rotations.to(double))  # columns: axes in the camera frame
    precision = (axes / scales[:, None, :] ** 2) @ axes.transpose(1, 2)
    offset = p - torch.as_tensor(camera.centre, dtype=double)
    direction = offset / offset.norm(dim=1, keepdim=True).clamp_min(1e-10)
    count = (sh_degree + 1) ** 2
    rgb = 0.5 + torch.einsum("nb,nbc->nc", sh_basis(direction)[:, :count], gaussians.sh.to(double)[:, :count])
    inward = torch.einsum("nij,nj->ni", precision, centre / depth[:, None])
    drawn = front & (opacity > ALPHA_MIN) & (pixel.abs() < CENTRE_LIMIT).all(1)
    pixel = pixel + torch.tensor([camera.cx, camera.cy], dtype=double)
    normal = -inward / inward.norm(dim=1, keepdim=True)
    return Projected(centre, depth, pixel, precision, opacity, rgb.clamp_min(0.0), normal, drawn)


def respond(seen: Projected, camera: Camera, pixels: Tensor) -> Responses:
    """Compute responses and blending weights of every Gaussian at pixels [P, 2], or [N, P, 2] with their own ones."""
    order = torch.argsort(seen.centre[:, 2].float(), stable=True)
    x, y = pixels.unbind(-1)
    rays = torch.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, torch.ones_like(x)], -1)
    rays = rays[order] if rays.dim() == 3 else rays.expand(len(order), *rays.shape)
    precision, centre = seen.precision[order], seen.centre[order]
    along = rays @ precision  # symmetric
    t = (along @ centre[..., None]).squeeze(-1) / (along * rays).sum(-1)
    offset = t[..., None] * rays - centre[:, None]
    power = -0.5 * (offset @ precision * offset).sum(-1)
    free = seen.opacity[order, None] * torch.exp(power)
    taken = seen.drawn[order, None] & (free > ALPHA_MIN) & (t > camera.near)
    alpha = torch.where(taken, free.clamp_max(ALPHA_MAX), 0.0)
    through = torch.cumprod(1 - alpha, 0)
    before = torch.cat([torch.ones_like(through[:1]), through[:-1]])
    weight = torch.where(before > T_STOP, alpha * before, 0.0)
    return Responses(order, free, t, before, weight)


def wanted_pixels(camera: Camera, tile_mask: Tensor | None) -> Tensor:
    """Mark the pixels in tiles of the mask, bool [H, W]."""
    if tile_mask is None:
        return torch.ones(camera.height, camera.width, dtype=torch.bool)
    grown = (tile_mask != 0).repeat_interleave(TILE, 0).repeat_interleave(TILE, 1)
    return grown[: camera.height, : camera.width]


def pixel_centres(wanted: Tensor) -> Tensor:
    """Return the pixel coordinates [P, 2] of the true entries of [H, W]."""
    return wanted.nonzero().flip(1).to(torch.float64) + 0.5


def _as_image(values: Tensor, wanted: Tensor) -> Tensor:
    """Arrange values of the wanted pixels [H, W] as an image, 0 elsewhere: [C, P] or [P] -> [C, H, W] or [H, W]."""
    out = values.new_zeros(*values.shape[:-1], *wanted.shape)
    out[..., wanted] = values
    return out


def render(
    gaussians: Gaussians,
    camera: Camera,
    sh_degree: int,
    tile_mask: Tensor | None = None,
    stats: RenderStats | None = None,
    error_map: Tensor | None = None,
    geometry: bool = True,
) -> Rendering:
    """Do as :func:`mgf_engine.raster.api.render`; the outputs are float64.

    Args:
        gaussians: normalised frame.
        camera: of the picture.
        sh_degree: of the colours.
        tile_mask: bool [tiles_y, tiles_x], tiles that are wanted; None for all.
        stats: to add to, or none.
        error_map: float32 [H, W], per-pixel error that ``stats.error`` gathers; None for zero.
        geometry: depth, normal and distortion are wanted, too.
    """
    wanted = wanted_pixels(camera, tile_mask)
    pixels = pixel_centres(wanted)
    seen = project(gaussians, camera, sh_degree)
    if stats is not None:
        pixels = pixels.expand(len(gaussians), *pixels.shape).clone().requires_grad_()
    r = respond(seen, camera, pixels)
    if stats is not None:
        _gather_statistics(r, pixels, stats, wanted, error_map, footprint_radius(seen, camera))
    w, rgb, normal = r.weight, seen.rgb[r.order], seen.normal[r.order]
    t = torch.where(w > 0, r.t, camera.near)
    image = partial(_as_image, wanted=wanted)

    color, alpha, depth = torch.einsum("np,nc->cp", w, rgb), w.sum(0), (w * t).sum(0)
    visible = torch.zeros(len(gaussians), dtype=torch.bool)
    visible[r.order] = (r.free > ALPHA_MIN).any(1) & seen.drawn[r.order]
    if not geometry:
        return Rendering(image(color), image(alpha), image(depth), None, None, None, visible)
    passes = (r.before > 0.5) & (r.before - w <= 0.5)
    m = camera.far / (camera.far - camera.near) * (1 - camera.near / t)
    distortion = alpha * (w * m * m).sum(0) - (w * m).sum(0) ** 2
    return Rendering(
        image(color),
        image(alpha),
        image(depth),
        image(torch.where(passes, t, 0.0).sum(0)),
        image(torch.einsum("np,nc->cp", w, normal)),
        image(distortion),
        visible,
    )


def uncertain(gaussians: Gaussians, camera: Camera, sh_degree: int, tile_mask: Tensor | None, margin: float) -> Tensor:
    """Mark the pixels where rounding may decide a yes-or-no rule, so that two correct rasterizers may differ, bool
    [H, W].

    Args:
        gaussians: normalised frame.
        camera: of the picture.
        sh_degree: of the colours.
        tile_mask: bool [tiles_y, tiles_x], tiles that are wanted; None for all.
        margin: relative distance to a threshold (response 1/255, the clamp at 0.99, transmittance 1e-4 and 1/2, the
            near plane) below which the decision counts as open.
    """
    wanted = wanted_pixels(camera, tile_mask)
    seen = project(gaussians, camera, sh_degree)
    with torch.no_grad():
        r = respond(seen, camera, pixel_centres(wanted))
    counts = seen.drawn[r.order, None] & (r.free > ALPHA_MIN * (1 - margin)) & (r.before > T_STOP * 0.5)
    after = r.before - r.weight
    close = (255 * r.free - 1).abs() < margin
    close |= (r.free / ALPHA_MAX - 1).abs() < margin
    close |= (r.t / camera.near - 1).abs() < margin
    close |= ((after / T_STOP - 1).abs() < 10 * margin) | ((2 * after - 1).abs() < margin)
    out = torch.zeros(camera.height, camera.width, dtype=torch.bool)
    out[wanted] = (close & counts).any(0)
    return out


def touched_tiles(gaussians: Gaussians, camera: Camera) -> Tensor:
    """Find the tiles in which some pixel's response is above 1/255, by trying every pixel, bool [N, tiles_y,
    tiles_x]."""
    tiles_y, tiles_x = camera.tiles
    whole = Camera(**{**vars(camera), "width": tiles_x * TILE, "height": tiles_y * TILE})
    seen = project(gaussians, camera, 0)
    with torch.no_grad():
        r = respond(seen, camera, pixel_centres(wanted_pixels(whole, None)))
    found = torch.zeros(len(gaussians), tiles_y * TILE, tiles_x * TILE, dtype=torch.bool)
    found[r.order] = ((r.free > ALPHA_MIN) & seen.drawn[r.order, None]).view(-1, tiles_y * TILE, tiles_x * TILE)
    return found.view(-1, tiles_y, TILE, tiles_x, TILE).any(4).any(2)


def footprint_radius(seen: Projected, camera: Camera) -> Tensor:
    """Compute the larger half extent in pixels of the conic where the response is 1/255, at most half the frame's
    diagonal, [N].

    In pixels relative to the centre, with ray d = K (dx, dy, 1): response >= 1/255 means
    (d'Pd)(m'Pm - k) <= (m'Pd)^2, P the precision and k = 2 ln(255 opacity): a quadratic form C in (dx, dy, 1). An
    ellipse's half extents follow from C^-1: the line x = c touches it where
    (C^-1)_22 c^2 - 2 (C^-1)_02 c + (C^-1)_00 = 0.
    """
    ray = torch.zeros(len(seen.depth), 3, 3, dtype=torch.float64)
    ray[:, 0, 0], ray[:, 1, 1] = 1 / camera.fx, 1 / camera.fy
    ray[:, :, 2] = seen.centre.detach() / seen.depth.detach()[:, None]
    precision, centre = seen.precision.detach(), seen.centre.detach()
    k = 2 * torch.log(255 * seen.opacity.detach().clamp_min(1e-30))
    along = torch.einsum("nij,nj->ni", precision, centre)
    form = precision * ((along * centre).sum(1) - k)[:, None, None] - along[:, :, None] * along[:, None, :]
    form = ray.transpose(1, 2) @ form @ ray
    diagonal = 0.5 * math.hypot(camera.width, camera.height)
    ellipse = (form[:, 0, 0] > 0) & (form[:, 0, 0] * form[:, 1, 1] > form[:, 0, 1] ** 2) & (k > 0)
    dual = torch.linalg.pinv(torch.where(ellipse[:, None, None], form, torch.eye(3, dtype=torch.float64)))
    half = [(dual[:, i, 2] / dual[:, 2, 2]) ** 2 - dual[:, i, i] / dual[:, 2, 2] for i in range(2)]
    radius = torch.sqrt(torch.maximum(*half).clamp_min(0.0))
    return torch.where(ellipse, radius.clamp_max(diagonal), diagonal)


def _gather_statistics(
    r: Responses, pixels: Tensor, stats: RenderStats, wanted: Tensor, error_map: Tensor | None, radius: Tensor
) -> None:
    """Fill ``stats`` when the gradient of the pixels' own coordinates [N, P, 2] arrives."""
    error = torch.zeros(wanted.shape) if error_map is None else error_map
    weight = torch.zeros_like(r.weight)
    weight[r.order] = r.weight.detach()

    def add(gradient: Tensor) -> None:
        total = weight.sum(1)
        stats.weight += total.float()
        stats.error += (weight * error[wanted].double()).sum(1).float()
        half_frames = gradient * torch.tensor([0.5 * wanted.shape[1], 0.5 * wanted.shape[0]])
        stats.gradient += half_frames.sum(1).norm(dim=1).float()
        stats.absolute_gradient += half_frames.norm(dim=2).sum(1).float()
        seen = total > 0
        stats.count += seen.to(torch.int32)
        stats.max_radius.copy_(torch.where(seen, torch.maximum(stats.max_radius, radius.float()), stats.max_radius))

    pixels.register_hook(add)
