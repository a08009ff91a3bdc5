"""One option, one device: training, prediction, refinement, editing and the layer keep all their
tensors where the user wants them.

Most of this runs on the CPU, on a device that is simulated (tests/support/fake_device.py): it
refuses numpy and mixed devices as CUDA does. Tests marked gpu run where torch sees a CUDA device.
"""

import math

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from learn.__main__ import COMMANDS
from learn.data import devices, lights
from learn.data.batch import ExampleBatch
from learn.data.data_split import DataSplit
from learn.data.framing import Framed
from learn.data.geometry import Geometry
from learn.data.settings import Data, Run, Schedule
from learn.editing import compositor, decomposition, photograph
from learn.figures import spheres
from learn.layer import predictions, render
from learn.metrics import intrinsics
from learn.networks import weights as checkpoint
from learn.networks.coding import Ranges
from learn.networks.compact import Compact
from learn.networks.prediction import Prediction
from learn.refinement import RefinementSettings, refine
from learn.refinement.settings import Level
from learn.training.loop import Training
from manifests.cli import main
from manifests.errors import InputError
from manifests.materials import load_catalogue
from tests.support import fake_device, synthetic
from tests.support.tiny_run import ALL_TERMS

SIZE = 32
CUDA = torch.cuda.is_available()
gpu = [pytest.mark.gpu, pytest.mark.skipif(not CUDA, reason="torch sees no CUDA device here")]
# Arguments that a command's parser asks for; the device is looked at before any of these files.
WORDS = {
    "train": ["smoke", "--data", "DATA", "--out", "OUT"],
    "train-baselines": ["--data", "DATA", "--out", "OUT"],
    "predict": ["picture.png", "--out", "OUT"],
    "edit": ["picture.png", "--material", "brass", "--out", "OUT"],
    "transfer": ["a.png", "b.png", "--out", "OUT"],
    "evaluate": ["--data", "DATA", "--out", "OUT"],
    "evaluate-network": ["weights.safetensors", "--data", "DATA", "--out", "OUT"],
    "evaluate-ladder": ["--data", "DATA", "--out", "OUT"],
    "agree": ["DATA", "--out", "OUT"],
    "app": [],
}


@pytest.fixture
def no_cuda(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)


@pytest.fixture
def two_cuda_devices(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)


@pytest.fixture
def device():
    """The simulated device, as long as the test lasts."""
    with fake_device.present():
        yield fake_device.DEVICE


def test_without_cuda_auto_is_the_cpu_and_asking_for_cuda_is_refused_in_one_line(no_cuda):
    assert devices.choose("auto") == devices.choose("cpu") == torch.device("cpu")
    with pytest.raises(
        InputError, match=r"--device: .*a CUDA device.*, found .*--device cpu"
    ) as refused:
        devices.choose("cuda")
    assert "\n" not in str(refused.value)


def test_with_cuda_auto_takes_it_and_each_process_of_torchrun_its_own(
    two_cuda_devices, monkeypatch
):
    assert devices.choose("auto") == devices.choose("cuda") == torch.device("cuda", 0)
    assert devices.choose("cpu") == torch.device("cpu")
    monkeypatch.setenv("LOCAL_RANK", "1")
    assert devices.choose("auto") == torch.device("cuda", 1)
    monkeypatch.setenv("LOCAL_RANK", "2")
    with pytest.raises(InputError, match=r"CUDA device 2.*found 2 of them.*at most 2 processes"):
        devices.choose("auto")


def test_every_command_takes_a_device_and_refuses_cuda_where_there_is_none(
    no_cuda, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    assert {*WORDS, "join-weights", "mask"} == set(COMMANDS)  # these two run no network
    for command, words in WORDS.items():
        assert main("learn", "", COMMANDS, [command, *words, "--device", "cuda"]) == 1
        (line,) = capsys.readouterr().err.splitlines()
        assert "--device: " in line and "a CUDA device" in line
    assert not list(tmp_path.iterdir())


def test_the_backend_of_processes_and_the_kind_of_autocast_follow_the_device():
    cpu, cuda = torch.device("cpu"), torch.device("cuda", 1)
    assert (devices.process_group_backend(cpu), devices.process_group_backend(cuda)) == (
        "gloo",
        "nccl",
    )
    for is_enabled in (True, False):
        with devices.mixed_precision(cpu, is_enabled):
            expected = devices.reduced_type(cpu) if is_enabled else torch.float32
            assert (torch.ones(2, 2) @ torch.ones(2, 2)).dtype == expected


@pytest.mark.parametrize(
    ("has_onednn", "has_kernels", "expected"),
    [(True, True, torch.bfloat16), (True, False, torch.float32), (False, None, torch.float32)],
)
def test_networks_compute_in_float32_where_the_processor_is_slow_in_bfloat16(
    monkeypatch, has_onednn, has_kernels, expected
):
    def supported():
        assert has_onednn  # other builds lack the operator
        return has_kernels

    monkeypatch.setattr(torch.backends.mkldnn, "is_available", lambda: has_onednn)
    monkeypatch.setattr(torch.ops.mkldnn, "_is_mkldnn_bf16_supported", supported)
    cpu = torch.device("cpu")
    assert devices.reduced_type(cpu) == expected
    assert devices.reduced_type(torch.device("cuda", 0)) == torch.bfloat16
    with devices.mixed_precision(cpu, True):
        assert (torch.ones(2, 2) @ torch.ones(2, 2)).dtype == expected


def test_mixed_precision_names_the_kind_of_its_device(monkeypatch):
    asked = []
    monkeypatch.setattr(torch, "autocast", lambda *given, **options: asked.append((given, options)))
    devices.mixed_precision(torch.device("cuda", 1), True)
    assert asked == [(("cuda", torch.bfloat16), {"enabled": True})]


def test_the_simulated_device_refuses_numpy_and_mixed_devices_and_learns(device):
    x = torch.ones(3).to(device)
    for refused in (lambda: x.numpy(), lambda: np.asarray(x)):
        with pytest.raises(TypeError, match="can't convert cuda:0"):
            refused()
    for mixed in (
        lambda: x + torch.ones(3),
        lambda: torch.cat([x, torch.ones(3)]),
        lambda: torch.ones(3)[x.long()],
    ):
        with pytest.raises(RuntimeError, match="same device"):
            mixed()
    layer = torch.nn.Linear(3, 2).to(device)
    layer(x).sum().backward()
    assert layer.weight.device == layer.weight.grad.device == device
    np.testing.assert_array_equal(devices.to_numpy(layer.weight.grad), np.ones((2, 3), np.float32))


def label_of(name):
    return torch.from_numpy(load_catalogue()[name].label.reshape(1, 108).astype(np.float32))


def ball(size, material="blue-rubber"):
    """A ball's picture (1, size, size, 3) with its normals, label, light and mask."""
    n, inside = synthetic.sphere(synthetic.Camera(size=(size, size)))
    n, inside, label = torch.from_numpy(n)[None], torch.from_numpy(inside)[None], label_of(material)
    L = torch.from_numpy(lights.draw_computed(np.random.default_rng(3)).astype(np.float32))[None]
    return render(n, label.exp(), L, mask=inside, method="exact"), n, label, L, inside


@pytest.mark.parametrize(
    "method", ["exact", "auto", "hybrid", "culled", "quadrature", "median_cut", "reflectance_map"]
)
def test_the_layer_stays_on_its_device_with_its_gradients(method, device):
    """Beside its own result on the CPU: the device has the reference sums, the CPU kernels, and
    1e-2 is what the methods promise.
    """
    # which is slow without its kernel
    _, n, label, L, inside = ball(16 if method == "quadrature" else 48)
    given = [
        tensor.to(device).requires_grad_()
        for tensor in (n, label.exp(), F.avg_pool2d(L.movedim(-1, 1), 4).movedim(1, -1))
    ]
    picture = render(*given, mask=inside.to(device), method=method)
    gradients = torch.autograd.grad(picture.sum(), given)
    assert {tensor.device for tensor in (picture, *gradients)} == {device}
    here = render(*(tensor.detach().cpu() for tensor in given), mask=inside, method=method)
    assert (picture.detach().cpu() - here).abs().mean() <= 1e-2 * here.mean()


@pytest.fixture(scope="module")
def data_splits(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dataset")
    synthetic.write_dataset(
        folder, [synthetic.matte()], np.random.default_rng(1), size=SIZE, category="sphere"
    )
    geometry, rng = Geometry(folder, progress=False), np.random.default_rng(2)
    # whose lobes are broad: a sharp one's reference sum is slow
    matte = np.array(synthetic.matte().label, np.float32)
    labels = {f"m{i}": (matte + rng.normal(0, 0.1, 108)).astype(np.float32) for i in range(4)}
    maps = [lights.draw_computed(rng).astype(np.float32) for _ in range(2)]
    return {
        side: DataSplit(geometry, np.arange(len(geometry)), labels, maps, side)
        for side in ("train", "validation", "test")
    }


def run(steps=2, **changes):
    schedule = Schedule(steps=steps, batch=2, warm_up=1)
    return Run(
        **{
            "name": "test",
            "size": SIZE,
            "data": Data(sharing=2),
            "losses": ALL_TERMS,
            "schedule": schedule,
            "seed": 3,
            "mixed_precision": False,
        }
        | changes
    )


def watched(training):
    """The devices of everything that a step has to do with."""
    tensors = [
        *training.network.parameters(),
        *training.network.buffers(),
        *training.average.values(),
    ]
    tensors += [p.grad for p in training.network.parameters() if p.grad is not None]
    tensors += [
        state[name]
        for state in training.optimiser.state.values()
        for name in ("exp_avg", "exp_avg_sq")
    ]
    return {tensor.device for tensor in tensors}


def test_training_and_validation_stay_on_their_device_and_lose_what_the_cpu_loses(
    data_splits, tmp_path, device
):
    """To 1e-3: the same numbers in another order of sums, the layer's in its reference instead of
    its kernels, after two steps of Adam.
    """
    there = Training(
        run(),
        data_splits,
        tmp_path / "there",
        sheet_every=2,
        checkpoint_every=1,
        workers=0,
        device=device,
    )
    seen = []
    there._terms = lambda *given, own=there._terms: seen.append(own(*given)) or seen[-1]
    figures = there.train()
    assert watched(there) == {device}
    assert {value.device for terms in seen for value in terms.values()} == {device}
    assert {"image_l2", "target_l2", "control_l2", "albedo", "irradiance"} <= set(figures)
    assert (tmp_path / "there" / "sheet-0000002.jpg").exists()
    here = Training(
        run(), data_splits, tmp_path / "here", sheet_every=2, checkpoint_every=1, workers=0
    )
    expected = here.train()
    assert {
        name: pytest.approx(value, rel=1e-2, abs=1e-3) for name, value in expected.items()
    } == figures
    for name, tensor in here.average.items():
        torch.testing.assert_close(there.average[name].cpu(), tensor, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("onto_the_cpu", [True, False])
def test_a_checkpoint_of_one_device_goes_on_on_another(data_splits, tmp_path, device, onto_the_cpu):
    first, second = (device, torch.device("cpu")) if onto_the_cpu else (torch.device("cpu"), device)
    half = Training(
        run(), data_splits, tmp_path, sheet_every=0, checkpoint_every=1, workers=0, device=first
    )
    next_batch = half._batches()
    half._make_step(next(next_batch).to(first))
    half.step = 1
    half._save_checkpoint()
    resumed = Training(
        run(), data_splits, tmp_path, sheet_every=0, checkpoint_every=1, workers=0, device=second
    )
    assert resumed.step == 1
    for name, tensor in half.average.items():
        torch.testing.assert_close(resumed.average[name].cpu(), tensor.cpu(), rtol=0, atol=0)
    resumed.train()
    assert watched(resumed) == {second}


def test_weights_give_the_same_network_on_every_device_and_ranges_on_the_cpu(weights, device):
    network, metadata = checkpoint.load_full_network(weights, device)
    assert (
        {tensor.device for tensor in network.state_dict().values()}
        == {device}
        == {devices.device_of(network)}
    )
    assert metadata["ranges"].centre.device == torch.device("cpu")


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    path = tmp_path_factory.mktemp("weights") / "w.safetensors"
    torch.manual_seed(0)
    labels = torch.from_numpy(
        np.stack([m.label.reshape(-1) for m in load_catalogue().values()])
    ).float()
    network = Compact(Ranges.of(labels))
    checkpoint.save_weights(path, network, network.state_dict(), '{"name": "tiny"}', SIZE)
    return path


def opened(size):
    """A Photograph of the lowest part of a ball."""
    picture, _, _, _, inside = ball(size)
    inside[:, : 3 * size // 4] = False  # a quarter of it: the reference sum is slow
    return photograph.Photograph(
        "ball",
        picture[0].numpy(),
        inside[0].float().numpy(),
        inside[0].long().numpy(),
        np.ones(3, np.float32),
        1.0,
    )


def test_a_prediction_is_made_on_the_networks_device(weights, device):
    picture, _, _, _, inside = ball(SIZE)
    framed = Framed(picture[0].numpy(), inside[0].numpy(), (0, 0, SIZE), 1.0)
    batch, there = decomposition.predict_framed(
        framed, checkpoint.load_full_network(weights, device)[0]
    )
    _, here = decomposition.predict_framed(framed, checkpoint.load_full_network(weights)[0])
    assert {batch.image.device, there.n.device, there.label.device, there.light.device} == {device}
    for name in ("n", "label", "light"):  # the same operators on the same numbers
        torch.testing.assert_close(
            getattr(there, name).cpu(), getattr(here, name), rtol=1e-5, atol=1e-5
        )


def test_an_edit_is_refined_and_rendered_on_the_networks_device(weights, device, monkeypatch):
    rendered_on = []
    monkeypatch.setattr(
        predictions,
        "render",
        lambda n, *given, **named: rendered_on.append(n.device) or render(n, *given, **named),
    )
    level = Level(pixels=40, light=(8, 16), method="exact", rounds=1, iterations=1)
    settings = RefinementSettings(levels=(level,), outer_iterations=1)
    result = decomposition.decompose(
        opened(SIZE), checkpoint.load_full_network(weights, device)[0], SIZE, settings
    )
    assert {
        tensor.device for tensor in (result.parts.n, result.parts.label, result.parts.light)
    } == {device}
    # the grid that is rendered, for the reference sum is slow
    monkeypatch.setattr(compositor, "COARSEST", SIZE)
    edited = compositor.Compositor(result, detail=0.25).edit([label_of("gold-paint")[0].numpy()])
    assert rendered_on and set(rendered_on) == {device}
    assert edited.shape == (SIZE, SIZE, 3) and np.isfinite(edited).all()
    shown = spheres.material_sphere(
        result.parts.label[0, 0],
        result.parts.light[0].movedim(0, -1),
        16,
        result.batch.elevation,
        1.0,
    )
    assert shown.shape == (16, 16, 3)


def scene_to_refine(size=12):
    """An ExampleBatch of a ball, and a start whose light is 10 % off and whose material is another
    rubber.
    """
    picture, n, label, L, inside = ball(size)
    image, n, light = (tensor.movedim(-1, 1).contiguous() for tensor in (picture, n, L))
    batch = ExampleBatch(
        image,
        inside[:, None].float(),
        n,
        inside.long(),
        label[None],
        light,
        label[None],
        ("ball",),
        math.radians(20),
    )
    return batch, Prediction(n, None, label_of("green-latex")[None], None, light * 1.1)


def refined_on(device):
    batch, start = scene_to_refine()
    moved = Prediction(*(None if part is None else part.to(device) for part in start))
    level = Level(pixels=0, light=(8, 16), method="exact", rounds=1, iterations=3)
    return refine(batch.to(device), moved, RefinementSettings(levels=(level,), outer_iterations=1))


def test_refinement_goes_down_on_its_device_as_far_as_on_the_cpu(device):
    there, here = refined_on(device), refined_on("cpu")
    assert {
        part.device for part in (there.prediction.n, there.prediction.label, there.prediction.light)
    } == {device}
    assert there.after["total"] < there.before["total"]
    # the settings' tolerance of the layer is 5e-3
    assert there.before["total"] == pytest.approx(here.before["total"], rel=1e-2)
    # a line search turns on the last digits
    assert there.after["total"] == pytest.approx(here.after["total"], rel=5e-2)


def test_figures_of_normals_materials_and_lights_are_read_from_any_device(device):
    batch, start = scene_to_refine()
    ranges = Ranges(torch.zeros(108), torch.ones(108))
    there = Ranges(ranges.centre.to(device), ranges.half.to(device))
    assert (
        intrinsics.normals(
            start.n[0].to(device), batch.n[0].to(device), (batch.segments[0] > 0).to(device)
        )["mean_deg"]
        < 0.1
    )
    small = [F.avg_pool2d(light, 4)[0] for light in (start.light, batch.light.flip(3))]
    here = intrinsics.material(start.label[0], batch.label[0], ranges) | intrinsics.light(
        *small, batch.elevation
    )
    labels = (start.label[0].to(device), batch.label[0].to(device))
    figures = intrinsics.material(*labels, there) | intrinsics.light(
        *(light.to(device) for light in small), batch.elevation
    )
    assert {
        name: pytest.approx(value, rel=1e-4, abs=1e-4) for name, value in here.items()
    } == figures


def test_a_batch_that_is_where_it_should_be_is_not_copied():
    batch, _ = scene_to_refine()
    assert batch.to("cpu") is batch


# On a GPU, where there is one


@pytest.mark.parametrize(
    "method", [pytest.param(name, marks=gpu) for name in ("exact", "auto", "hybrid", "quadrature")]
)
def test_the_layer_on_cuda_is_the_layer_on_the_cpu(method):
    """Within what the methods promise, 1e-2 of the mean; the exact sum to float32's rounding over
    8,192 texels.
    """
    _, n, label, L, inside = ball(64)
    here = render(n, label.exp(), L, mask=inside, method=method)
    given = [tensor.cuda().requires_grad_() for tensor in (n, label.exp(), L)]
    there = render(*given, mask=inside.cuda(), method=method)
    assert all(
        gradient.is_cuda and gradient.isfinite().all()
        for gradient in torch.autograd.grad(there.sum(), given)
    )
    assert (there.detach().cpu() - here).abs().mean() <= (
        1e-4 if method == "exact" else 1e-2
    ) * here.mean()


@pytest.mark.parametrize("workers", [pytest.param(count, marks=gpu) for count in (0, 1)])
def test_a_training_step_on_cuda_loses_what_the_cpu_loses(data_splits, tmp_path, workers):
    there, here = (
        Training(
            run(steps=1), data_splits, tmp_path / name, sheet_every=1, workers=workers, device=name
        ).train()
        for name in ("cuda", "cpu")
    )
    # convolutions on CUDA may use TF32, of three digits
    assert {name: pytest.approx(value, rel=5e-2, abs=5e-2) for name, value in here.items()} == there


@pytest.mark.parametrize("what", [pytest.param("prediction", marks=gpu)])
def test_a_prediction_on_cuda_is_that_of_the_cpu(what, weights):
    picture, _, _, _, inside = ball(SIZE)
    framed = Framed(picture[0].numpy(), inside[0].numpy(), (0, 0, SIZE), 1.0)
    (_, there), (_, here) = (
        decomposition.predict_framed(framed, checkpoint.load_full_network(weights, name)[0])
        for name in ("cuda", "cpu")
    )
    assert there.n.is_cuda
    torch.testing.assert_close(there.label.cpu(), here.label, rtol=5e-2, atol=5e-2)  # TF32


@pytest.mark.parametrize("what", [pytest.param("refinement", marks=gpu)])
def test_a_refinement_on_cuda_goes_as_far_down_as_on_the_cpu(what):
    there, here = refined_on("cuda"), refined_on("cpu")
    assert there.prediction.n.is_cuda
    assert there.after["total"] == pytest.approx(here.after["total"], rel=5e-2)
