"""NIM as a layer: the kernel's values, finite gradients, and what compilers make of it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from nimprep import Camera, estimate_normals
from nimprep.errors import ArrayError
from tests.derive.test_normals import CAMERA, kitti_frame, plane_depth, scene, unit, with_holes

torch = pytest.importorskip("torch")

from nimprep.torch.nim import NIM  # noqa: E402

FILTERS = pytest.mark.parametrize("sign_filter", [False, True], ids=["plain", "sign filter"])


def batch(*depths, camera=CAMERA):
    """Return (B, 1, H, W) depth and (B, 3, 3) intrinsics, both of the camera."""
    matrix = torch.from_numpy(camera.matrix)
    return torch.from_numpy(np.stack(depths))[:, None], matrix.repeat(len(depths), 1, 1)


def images(normals):
    """Return (B, H, W, 3) from (B, 3, H, W)."""
    return normals.detach().permute(0, 2, 3, 1).numpy()


def check_parity(depth, camera, sign_filter=False):
    found = images(NIM(sign_filter=sign_filter)(*batch(depth, camera=camera)))[0]
    expected = estimate_normals(depth, camera, sign_filter=sign_filter)
    assert np.array_equal(found.any(axis=-1), expected.any(axis=-1))
    assert np.mean(np.abs(found - expected).max(axis=-1) > 1e-5) <= 1e-4


def test_a_plane_gives_its_own_normal():
    normal = unit((-0.5, -0.7, -0.6))
    found = images(NIM()(*batch(plane_depth(normal, 2.0, CAMERA))))[0]
    seen = found.any(axis=-1)
    assert seen.all()
    assert np.abs(found[1:-1, 1:-1] - normal).max() < 1e-4


@FILTERS
@pytest.mark.parametrize("scale", [1e-3, 1.0, 30.0])
@pytest.mark.parametrize("share", [0, 0.25, 0.8], ids=["whole", "holes", "mostly holes"])
def test_any_depth_gives_what_the_kernel_gives(share, scale, sign_filter):
    check_parity(with_holes(scene() * np.float32(scale), share), CAMERA, sign_filter)


@FILTERS
def test_unrelated_depths_give_what_the_kernel_gives(sign_filter):
    depth = np.random.default_rng(1).uniform(0.3, 60, CAMERA.shape).astype(np.float32)
    check_parity(with_holes(depth, 0.3), CAMERA, sign_filter)


@FILTERS
@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (2, 2)])
def test_thin_images_give_what_the_kernel_gives(shape, sign_filter):
    camera = Camera(fx=40, fy=50, cx=shape[1] / 3, cy=shape[0] / 4, width=shape[1], height=shape[0])
    depth = np.random.default_rng(2).uniform(1, 2, shape).astype(np.float32)
    check_parity(depth, camera, sign_filter)


@FILTERS
def test_a_kitti_frame_gives_what_the_kernel_gives(reference_data, sign_filter):
    check_parity(*kitti_frame(reference_data), sign_filter)


@FILTERS
def test_a_gmrp_frame_gives_what_the_kernel_gives(reference_data, sign_filter):
    path = reference_data / "gmrp" / "depth_u16" / "000001.png"
    raw = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    depth = np.where(raw == 65535, 0, raw) / np.float32(1000)
    check_parity(depth, Camera.from_fov(69.4, 1280, 720), sign_filter)


def test_each_frame_of_a_batch_has_its_own_camera():
    other = Camera(fx=50.0, fy=90.0, cx=10.0, cy=30.0, width=CAMERA.width, height=CAMERA.height)
    depth, k = batch(scene(0), scene(1))
    k[1] = torch.from_numpy(other.matrix)
    found = images(NIM()(depth, k.float()))
    for i, camera in enumerate((CAMERA, other)):
        np.testing.assert_allclose(found[i], estimate_normals(scene(i), camera), atol=1e-4)


NONE = (np.nan, -np.nan, np.inf, -np.inf, -2.0, 1e-45, 1e-20, 9.9e-5, -1e-20)


@pytest.mark.parametrize("value", NONE)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_what_is_no_depth_gives_no_normal_and_no_gradient(value, dtype):
    whole = with_holes(scene(), 0.2)
    marked = np.where(whole == 0, value, whole.astype(np.float64))
    depth, k = batch(whole)
    odd = torch.from_numpy(marked)[None, None].to(dtype).requires_grad_()
    found, expected = NIM()(odd, k), NIM()(depth.to(dtype), k)
    assert torch.equal(found, expected)
    with torch.autograd.set_detect_anomaly(True):
        (found * torch.linspace(-1, 1, found.numel()).reshape(found.shape)).sum().backward()
    assert torch.isfinite(odd.grad).all()
    assert not odd.grad[depth == 0].any()


def test_depth_is_where_the_kernel_has_it_and_normals_are_finite_whatever_it_is():
    least = np.float32(1e-4)
    values = [0, np.nextafter(least, np.float32(0)), least, 1e-3, 1, 1e10, 1e20, 1e30, 3.4e38]
    depth = np.random.default_rng(0).choice(np.array(values, np.float32), CAMERA.shape)
    some = estimate_normals(depth, CAMERA).any(axis=-1)
    for dtype in (torch.float32, torch.float64):
        odd, k = batch(depth)
        odd = odd.to(dtype).requires_grad_()
        found = NIM()(odd, k)
        assert np.array_equal(found.detach().numpy()[0].any(axis=0), some)
        assert torch.isfinite(found).all()
        found.sum().backward()
        assert torch.isfinite(odd.grad).all()


@FILTERS
@pytest.mark.parametrize("share", [0, 0.3, 0.95, 1], ids=["whole", "holes", "crumbs", "nothing"])
def test_gradients_are_finite_at_holes_borders_and_flat_places(share, sign_filter):
    depth = scene()
    depth[10:30, 10:30] = 3.7
    # One unit in the last place: the steepest gradient there is.
    depth[20, 20] = np.nextafter(depth[20, 20], np.float32(4))
    depth[40, 40] = 1e-4
    depth, k = batch(with_holes(depth, share))
    depth[0, 0, 5, 5] = np.nan
    depth.requires_grad_()
    k.requires_grad_()
    normals = NIM(sign_filter=sign_filter)(depth, k)
    weights = torch.linspace(-1, 1, normals.numel()).reshape(normals.shape)
    with torch.autograd.set_detect_anomaly(True):
        (normals * weights).sum().backward()
    assert torch.isfinite(depth.grad).all()
    assert torch.isfinite(k.grad).all()
    assert not depth.grad[~(depth > 0)].any()
    assert share > 0.9 or depth.grad.any()


@FILTERS
def test_gradients_are_those_of_finite_differences(sign_filter):
    v, u = torch.meshgrid(torch.arange(5.0), torch.arange(6.0), indexing="ij")
    depth = (3 + 0.3 * u + 0.2 * v + 0.05 * torch.sin(u * v)).double()
    depth[2, 3] = 0
    mask = (depth > 0)[None, None]
    k = torch.tensor([[[5.0, 0, 2], [0, 6, 2.5], [0, 0, 1]]], dtype=torch.float64)

    def normals(depth, k):
        return NIM(sign_filter=sign_filter)(torch.where(mask, depth, 0.0), k)

    inputs = (depth[None, None].requires_grad_(), k.requires_grad_())
    assert normals(*inputs).dtype == torch.float64
    assert torch.autograd.gradcheck(normals, inputs)


def test_autocast_and_half_precision_inputs_compute_in_float32():
    depth, k = batch(scene())
    expected = NIM()(depth, k)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert torch.equal(NIM()(depth, k), expected)
    half = NIM()(depth.half(), k)
    assert half.dtype == torch.float32
    assert torch.equal(half, NIM()(depth.half().float(), k))


def test_tensors_need_not_be_contiguous():
    depth, k = batch(with_holes(scene(0), 0.2), scene(1))
    expected = NIM()(depth, k)
    turned = depth.transpose(2, 3).contiguous().transpose(2, 3)
    wide = torch.zeros((2, 2, *depth.shape[2:]))
    wide[:, 1:] = depth
    for odd in (turned, wide[:, 1:], depth.to(memory_format=torch.channels_last)):
        assert torch.equal(odd, depth)
        assert torch.equal(NIM()(odd, k.transpose(1, 2).contiguous().transpose(1, 2)), expected)


def test_torch_compile_takes_it_whole_with_gradients():
    depth, k = batch(with_holes(scene(), 0.2))
    layer = NIM(sign_filter=True)
    compiled = torch.compile(layer, fullgraph=True, backend="aot_eager")
    found = compiled(depth.requires_grad_(), k)
    assert torch.allclose(found, layer(depth, k), atol=1e-6)
    found.sum().backward()
    assert torch.isfinite(depth.grad).all()


def test_torch_export_takes_any_batch_and_size():
    depth, k = batch(with_holes(scene(0), 0.2), scene(1))
    layer = NIM(sign_filter=True)
    number, height, width = (torch.export.Dim(name, min=1) for name in ("B", "H", "W"))
    program = torch.export.export(
        layer, (depth, k), dynamic_shapes=({0: number, 2: height, 3: width}, {0: number})
    )
    small = depth[:1, :, :20, :33]
    assert torch.equal(program.module()(small, k[:1]), layer(small, k[:1]))


def test_it_has_nothing_to_learn_or_save_and_names_its_options():
    layer = NIM(sign_filter=True)
    assert not layer.state_dict()
    assert repr(layer) == "NIM(method='nim', sign_filter=True)"


def test_other_shapes_and_methods_are_refused():
    depth, k = batch(scene())
    with pytest.raises(ArrayError, match=r"expected \(B, 1, H, W\), found \(48, 64\)"):
        NIM()(depth[0, 0], k)
    with pytest.raises(ArrayError, match=r"expected \(1, 3, 3\) .*found \(3, 3\)"):
        NIM()(depth, k[0])
    with pytest.raises(ArrayError, match="expected one of 'nim', found 'sobel'"):
        NIM("sobel")
