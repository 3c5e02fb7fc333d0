"""Codecs and their decoders: lossless is bit-exact, near-lossless is bounded, hostile blocks are refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from ground.ingest.codecs import Ccsds121Decoder, PlanesDecoder, RawDecoder, SqrtPlanesDecoder, inflate
from ground.ingest.rans import SPANS, RansDecoder, sky_model
from onboard.downlink.codec import Ccsds121Codec, PlanesCodec, RansCodec, RawCodec, SqrtPlanesCodec
from onboard.downlink.codec import rans as rans_on_board
from sboc_e2e.icd.errors import ContractError
from sboc_e2e.icd.layout import MAX_STRIP_PIXELS, CodecNumber
from sboc_e2e.icd.steps import Decoder, Encoder

LOSSLESS = [
    (PlanesCodec(), PlanesDecoder()),
    (Ccsds121Codec(), Ccsds121Decoder()),
    (RawCodec(), RawDecoder()),
    (RansCodec(), RansDecoder()),
]
ALL = [*LOSSLESS, (SqrtPlanesCodec(), SqrtPlanesDecoder())]
NAMES = ["planes", "ccsds121", "raw", "rans", "sqrt_planes"]
N_LOSSLESS = len(LOSSLESS)
SIGMA_ADU = 2.37
GOLDEN = Path(__file__).parents[1] / "golden"

blocks = hnp.arrays(np.int32, hnp.array_shapes(min_dims=2, max_dims=2, max_side=40), elements=st.integers(-(2**17), 2**17))
levels = st.integers(-(2**17), 2**17)


def noise(level: float, sigma: float, shape: tuple[int, int], seed: int = 1) -> NDArray[np.int32]:
    """Rounded Gaussian noise."""
    return np.random.default_rng(seed).normal(level, sigma, shape).round().astype(np.int32)


def entropy_bits(sigma: float) -> float:
    """Entropy of a rounded Gaussian with a random fraction of a step in its mean."""
    k = np.arange(-200, 201)
    from scipy.stats import norm

    total = 0.0
    for phase in (np.arange(16) + 0.5) / 16:
        p = np.diff(norm.cdf(np.append(k - 0.5, 200.5), phase, sigma))
        total -= np.sum(p[p > 0] * np.log2(p[p > 0])) / 16
    return total


@pytest.mark.parametrize(("encoder", "decoder"), ALL, ids=NAMES)
def test_numbers_are_those_of_the_contract(encoder: Encoder, decoder: Decoder) -> None:
    """Both halves of a codec have the number that ICD.md fixes, and match their Protocols."""
    assert isinstance(encoder, Encoder)
    assert isinstance(decoder, Decoder)
    assert encoder.number == decoder.number
    assert encoder.number in set(CodecNumber)


@pytest.mark.parametrize(("encoder", "decoder"), LOSSLESS, ids=NAMES[:N_LOSSLESS])
@given(values=blocks, level=levels)
def test_lossless_is_bit_exact(encoder: Encoder, decoder: Decoder, values: NDArray[np.int32], level: int) -> None:
    """Any integers around any level come back."""
    block = encoder.encode(values, level_adu=level, sigma_adu=1.0)
    assert (decoder.decode(block, values.shape, level_adu=level, sigma_adu=1.0) == values).all()


@pytest.mark.parametrize(("encoder", "decoder"), LOSSLESS, ids=NAMES[:N_LOSSLESS])
@pytest.mark.parametrize("value", [-(2**31), -1, 0, 255, 256, 65535, 2**31 - 1])
def test_constant_blocks_of_any_value(encoder: Encoder, decoder: Decoder, value: int) -> None:
    """Constant and extreme values, around levels at the other end."""
    values = np.full((5, 7), value, dtype=np.int32)
    for level in (0, value, -(2**31), 2**31 - 1):
        block = encoder.encode(values, level_adu=level, sigma_adu=1.0)
        assert (decoder.decode(block, (5, 7), level_adu=level, sigma_adu=1.0) == values).all()


@pytest.mark.parametrize("sky", [100, 128, 255, 256, 512, 1024])
def test_cost_does_not_depend_on_where_the_sky_falls(sky: int) -> None:
    """The trap of plain byte shuffling: 1.5 bits per pixel at multiples of 256."""
    values = noise(sky, SIGMA_ADU, (64, 64))
    bits = 8.0 * len(PlanesCodec().encode(values, level_adu=sky, sigma_adu=SIGMA_ADU)) / values.size
    assert bits <= 1.08 * entropy_bits(SIGMA_ADU)


@pytest.mark.parametrize("sigma", [1.0, 2.37, 6.9, 17.5])
def test_planes_come_near_the_entropy(sigma: float) -> None:
    """A block of 256 x 256 px costs at most 1.03 times its entropy."""
    values = noise(300.3, sigma, (256, 256))
    bits = 8.0 * len(PlanesCodec().encode(values, level_adu=300, sigma_adu=sigma)) / values.size
    assert bits <= 1.03 * entropy_bits(sigma) + 0.01


@pytest.mark.parametrize("sigma", [1.0, 2.37, 6.9, 17.5, 40.0])
def test_rans_comes_nearer_to_the_entropy(sigma: float) -> None:
    """A block of 64 x 148 px, which fills a packet, costs at most 1.02 times its entropy; level and noise need not be exact."""
    values = noise(300.3, sigma, (64, 148))
    for level, given_sigma in ((300, sigma), (298, 3.0 * sigma)):
        bits = 8.0 * len(RansCodec().encode(values, level_adu=level, sigma_adu=given_sigma)) / values.size
        assert bits <= 1.02 * entropy_bits(sigma) + 0.01


@pytest.mark.parametrize("kind", ["zero", "constant", "saturated", "half saturated", "random", "stars", "any integers", "ramp"])
@pytest.mark.parametrize("shape", [(64, 64), (1, 9), (9, 1), (3, 2), (5, 1021)])
def test_rans_is_bit_exact_on_frames_of_every_kind(kind: str, shape: tuple[int, int]) -> None:
    """What the model does not expect costs bits, never a value."""
    rng = np.random.default_rng(5)
    sky = noise(100.0, 2.4, shape)
    values = {
        "zero": np.zeros(shape, dtype=np.int32),
        "constant": np.full(shape, 31_111, dtype=np.int32),
        "saturated": np.full(shape, 65_535, dtype=np.int32),
        "half saturated": np.where(np.arange(shape[1]) < shape[1] // 2, sky, 65_535).astype(np.int32),
        "random": rng.integers(0, 65_536, shape).astype(np.int32),
        "stars": sky + rng.pareto(0.9, shape).clip(0, 60_000).astype(np.int32),
        "any integers": rng.integers(-(2**31), 2**31, shape).astype(np.int32),
        "ramp": np.add.outer(np.arange(shape[0]), 70 * np.arange(shape[1])).astype(np.int32),
    }[kind]
    for level in (0, 100, int(values[0, 0])):
        block = RansCodec().encode(values, level_adu=level, sigma_adu=2.4)
        assert (RansDecoder().decode(block, shape, level_adu=level, sigma_adu=0.0) == values).all()


def test_both_halves_work_out_the_same_model_of_the_sky() -> None:
    """Limits and slots of on board and ground, each worked out in its own way, over noise and centre."""
    assert (np.column_stack((rans_on_board.FIRST, rans_on_board.LAST)) == SPANS).all()
    centres = np.random.default_rng(2).integers(-60, 60, 256)
    for noise_code in range(0, 256, 4):
        for centre_code in (0, 8, -8, int(centres[noise_code]), 32767, -32768):
            limits, table = rans_on_board.model(noise_code, centre_code)
            there_limits, slots, _ = sky_model(noise_code, centre_code)
            assert (limits == there_limits).all()
            assert (table["start"].reshape(slots.shape[0], -1) == slots[:, :-1]).all()


def test_golden_rans_block() -> None:
    """The block on disk and its values; ICD.md alone must be enough to read it."""
    values = np.loadtxt(GOLDEN / "rans.csv", dtype=np.int32, delimiter=",")
    block = (GOLDEN / "rans.bin").read_bytes()
    assert RansCodec().encode(values, level_adu=5, sigma_adu=2.375) == block
    assert (RansDecoder().decode(block, values.shape, level_adu=5, sigma_adu=2.375) == values).all()


@pytest.mark.parametrize("cut", [0, 1, 22, 24, -1, -2])
def test_rans_refuses_what_does_not_end_as_it_began(cut: int) -> None:
    """Blocks cut short, and one with a word too many."""
    values = noise(50.0, 3.0, (20, 30))
    block = RansCodec().encode(values, level_adu=50, sigma_adu=3.0)
    for wrong in (block[:cut], block + b"\0\0", block[:3] + bytes(5) + block[8:], block[:-2] + bytes([block[-2] ^ 1, block[-1]])):
        with pytest.raises(ContractError):
            RansDecoder().decode(wrong, values.shape, level_adu=50, sigma_adu=3.0)


@given(values=blocks, level=levels, sigma=st.floats(0.1, 1000.0), step=st.floats(0.05, 4.0))
def test_near_lossless_errs_by_less_than_half_a_step(values: NDArray[np.int32], level: int, sigma: float, step: float) -> None:
    """|error| <= half the step at the pixel's own noise (plus one ADU for rounding)."""
    sigma = float(np.float32(sigma))
    encoder = SqrtPlanesCodec(step_sigma=step)
    block = encoder.encode(values, level_adu=level, sigma_adu=sigma)
    back = SqrtPlanesDecoder().decode(block, values.shape, level_adu=level, sigma_adu=sigma)
    above = values.astype(np.float64) - level
    step_adu = max(1.0, round(step * sigma))
    growth = np.sqrt(1.0 + np.maximum(above - 3.0 * sigma, 0.0) / (1.2 * sigma**2)) + step_adu / (1.2 * sigma**2)
    slack = 1.0 + np.abs(values) * 2e-7
    assert (np.abs(back - values) <= 0.5 * step_adu * growth + slack).all()


def test_two_adu_step_costs_three_percent_of_noise_and_no_bias() -> None:
    """The preset's goal: step 2 ADU, at most 2.4 bits per pixel, at most 3 % more noise, bias below 1 % of sigma."""
    values = noise(100.4, SIGMA_ADU, (512, 128))
    block = SqrtPlanesCodec().encode(values, level_adu=100, sigma_adu=SIGMA_ADU)
    back = SqrtPlanesDecoder().decode(block, values.shape, level_adu=100, sigma_adu=SIGMA_ADU)
    assert 8.0 * len(block) / values.size <= 2.4
    error = back - values
    assert np.sqrt(1.0 + error.var() / SIGMA_ADU**2) <= 1.03
    assert abs(error.mean()) < 0.01 * SIGMA_ADU


@pytest.mark.parametrize("decoder", [d for _, d in ALL], ids=NAMES)
@given(block=st.binary(max_size=300), rows=st.integers(0, 600), cols=st.integers(0, 600), sigma=st.floats(0.0, 1e9))
def test_any_bytes_decode_or_are_refused(decoder: Any, block: bytes, rows: int, cols: int, sigma: float) -> None:
    """Hostile blocks give the announced shape or a ContractError, nothing else."""
    try:
        values = decoder.decode(block, (rows, cols), level_adu=0, sigma_adu=sigma)
    except ContractError:
        return
    assert values.shape == (rows, cols)


@pytest.mark.parametrize(("encoder", "decoder"), ALL, ids=NAMES)
@given(data=st.data())
def test_damaged_blocks_decode_or_are_refused(encoder: Encoder, decoder: Decoder, data: st.DataObject) -> None:
    """A real block with bytes changed, cut or added."""
    values = noise(50.0, 3.0, (20, 30))
    block = bytearray(encoder.encode(values, level_adu=50, sigma_adu=3.0))
    for _ in range(data.draw(st.integers(1, 4))):
        block[data.draw(st.integers(0, len(block) - 1))] = data.draw(st.integers(0, 255))
    block = block[: data.draw(st.integers(0, len(block)))] + data.draw(st.binary(max_size=8))
    try:
        back = decoder.decode(bytes(block), (20, 30), level_adu=50, sigma_adu=3.0)
    except ContractError:
        return
    assert back.shape == (20, 30)


def test_a_zip_bomb_is_refused_before_it_is_inflated() -> None:
    """A small frame that announces, or hides, a large content."""
    bomb = zstandard.ZstdCompressor(level=19).compress(bytes(50_000_000))
    assert len(bomb) < 4096
    with pytest.raises(ContractError, match="its header announces 50000000"):
        inflate(bomb, 1000)
    hidden = zstandard.ZstdCompressor(level=19, write_content_size=False).compress(bytes(50_000_000))
    with pytest.raises(ContractError, match="its header announces"):
        inflate(hidden, 1000)
    with pytest.raises(ContractError, match="expected 1 to 65536 pixels"):
        PlanesDecoder().decode(b"\x04" + bomb, (MAX_STRIP_PIXELS + 1, 1), level_adu=0, sigma_adu=1.0)
