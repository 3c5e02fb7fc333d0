"""The page of a validation: both images side by side, the curves, the figures."""

from collections.abc import Sequence
from html import escape
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from sboc_e2e.report.page import simple_page, table
from sboc_e2e.report.pictures import cutout, preview, stretch
from sboc_e2e.report.plots import BLUE, ORANGE, canvas, svg
from sboc_e2e.validation import distances
from sboc_e2e.validation.figures import Side, Validation, counted, matched_values

PICTURE_PX = 360
"""Side of each half of the small picture."""
GREY_STEP = 8
"""Greys are rounded to this: noise does not compress otherwise."""
NAMES = ("simulated", "real")
COLOURS = (BLUE, ORANGE)


def page(result: Validation) -> str:
    """Self-contained HTML."""
    figures = result.figures
    pieces = [
        f"<p>Simulated: {escape(figures['simulated']['name'])}. Real: {escape(figures['real']['name'])}. "
        "Gain and bias are matched first (median and robust noise of source-free pixels); everything below is in units of that "
        "noise.</p>",
        '<h2>Images</h2><div class="plots">',
        *(_image(side, name) for side, name in zip((result.simulated, result.real), NAMES, strict=True)),
        '</div><div class="plots">',
        *(_brightest(side, name) for side, name in zip((result.simulated, result.real), NAMES, strict=True)),
        '</div><h2>Curves</h2><div class="plots">',
        _figure(_histogram_plot(result), "pixel values after the match: source-free (left), all pixels (right)"),
        _figure(_spectrum_plot(result), "noise power over that of white noise: radial (left), along rows and columns (right)"),
        _figure(_count_plot(result), "stars brighter than a flux, for each square megapixel"),
        _figure(_width_plot(result), "widths of isolated stars: Gaussian fits, major axis (left) and minor (right)"),
        "</div><h2>Figures</h2>",
        table(("figure", "simulated", "real", "distance"), _rows(figures)),
        "<h2>Notes</h2><ul>",
        *(f"<li>{name}: {escape(note)}</li>" for name in NAMES for note in figures[name]["notes"]),
        "</ul>",
    ]
    return simple_page("Validation against a real frame", pieces)


def picture(result: Validation) -> bytes:
    """A small PNG for documents: real on the left, simulated on the right, in the same units and with one stretch."""
    real, simulated = result.real.picture.image, result.simulated.picture.image
    images = (real, result.match.gain * simulated + result.match.bias)
    scale = PICTURE_PX / max(real.shape)
    size = (max(1, round(real.shape[1] * scale)), max(1, round(real.shape[0] * scale)))
    small = [cv2.resize(image.astype(np.float32), size, interpolation=cv2.INTER_AREA) for image in images]
    grey = stretch(np.hstack([small[0], np.full((size[1], 6), np.nan, np.float32), small[1]]))
    _, encoded = cv2.imencode(".png", grey // GREY_STEP * GREY_STEP, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    return encoded.tobytes()


def _figure(content: str, caption: str) -> str:
    return f"<figure>{content}<figcaption>{escape(caption)}</figcaption></figure>"


def _image(side: Side, name: str) -> str:
    text = f"{name}: {side.picture.name}, {side.picture.image.shape[0]} x {side.picture.image.shape[1]} px"
    uri = preview(side.picture.image)
    return _figure(f'<img src="{uri}" alt="{escape(text)}" style="width:100%;image-rendering:pixelated">', text)


def _brightest(side: Side, name: str) -> str:
    """Cut-outs of the four brightest stars at full resolution."""
    pieces = []
    for k in range(min(4, len(side.sources))):
        uri, _, _ = cutout(side.picture.image, side.sources.row[k], side.sources.col[k], 48)
        pieces.append(f'<img src="{uri}" alt="star {k + 1}" style="width:24%;image-rendering:pixelated">')
    return _figure(" ".join(pieces) or "no star", f"{name}: brightest stars, 48 px")


def _sides(result: Validation) -> Sequence[tuple[Side, str, str]]:
    return tuple(zip((result.simulated, result.real), NAMES, COLOURS, strict=True))


def _legend(ax: Any, **style: Any) -> None:
    """A legend where something is drawn; matplotlib warns of one without an entry."""
    if ax.get_legend_handles_labels()[1]:
        ax.legend(**style)


def _histogram_plot(result: Validation) -> str:
    with canvas(8.0, 3.2, columns=2) as (figure, axes):
        for ax, everything in zip(axes, (False, True), strict=True):
            values = [matched_values(side, everything=everything) for side, _, _ in _sides(result)]
            edges = distances.shared_bins(values[0], values[1])
            middle = 0.5 * (edges[1:] + edges[:-1])
            for value, (_, name, colour) in zip(values, _sides(result), strict=True):
                density = distances.histogram(value, edges) / (len(value) * np.diff(edges))
                ax.step(middle, density, where="mid", color=colour, label=name, lw=1.2)
            ax.set(yscale="log", xlabel="(value - median) / noise", ylabel="density")
        axes[0].legend()
        return svg(figure)


def _spectrum_plot(result: Validation) -> str:
    with canvas(8.0, 3.2, columns=2) as (figure, axes):
        for side, name, colour in _sides(result):
            spectrum = side.spectrum
            if spectrum is None:
                continue
            axes[0].plot(spectrum.frequency, spectrum.radial, "o-", ms=3, color=colour, label=name)
            f = np.arange(1, len(spectrum.along_rows) + 1) / (2 * (len(spectrum.along_rows) + 1))
            axes[1].plot(f, spectrum.along_rows, "-", color=colour, lw=1.0, label=f"{name}, along rows")
            axes[1].plot(f, spectrum.along_cols, "--", color=colour, lw=1.0, label=f"{name}, along columns")
        for ax in axes:
            ax.set(xlabel="cycles per px", ylabel="power / white", ylim=(0, None))
            _legend(ax, fontsize=7)
        return svg(figure)


def _count_plot(result: Validation) -> str:
    with canvas(5.0, 3.4) as (figure, (ax,)):
        for side, name, colour in _sides(result):
            flux = np.sort(counted(side))[::-1]
            if len(flux):
                density = np.arange(1, len(flux) + 1) / (side.picture.image.size * 1e-6)
                ax.step(flux, density, where="post", color=colour, label=name)
        ax.set(xscale="log", yscale="log", xlabel="flux / noise of a pixel", ylabel="N(> F) per Mpx")
        _legend(ax)
        return svg(figure)


def _width_plot(result: Validation) -> str:
    with canvas(8.0, 3.2, columns=2) as (figure, axes):
        for ax, axis in zip(axes, ("major", "minor"), strict=True):
            values: list[NDArray[np.float64]] = [getattr(side.widths, axis) for side, _, _ in _sides(result)]
            both = np.concatenate(values)
            if len(both):
                low, high = np.percentile(both, [1, 99])
                edges = np.linspace(0.9 * low, 1.1 * high, 25)
                for value, (_, name, colour) in zip(values, _sides(result), strict=True):
                    inside = np.clip(value, edges[0], edges[-1])
                    ax.hist(inside, edges, histtype="step", color=colour, label=f"{name}, n = {len(value)}")
                ax.legend(fontsize=7)
            ax.set(xlabel=f"FWHM along the {axis} axis (px)", ylabel="stars")
        return svg(figure)


def _text(value: Any) -> str:
    """A number or a figure as a cell."""
    if value is None:
        return "-"
    if isinstance(value, dict):
        if value.get("value") is None:
            return f"- ({value.get('reason', 'nothing to measure')})"
        return f"{value['value']:.4g} [{value['low']:.4g}, {value['high']:.4g}], n = {value['n']}"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


Row = tuple[str, str, str, str]


def _row(name: str, pair: Sequence[Any], distance: Any = "") -> Row:
    """A line of the table: name, simulated, real, distance."""
    return name, _text(pair[0]), _text(pair[1]), _text(distance)


def _rows(figures: dict[str, Any]) -> list[Row]:
    match, histogram, noise = figures["match"], figures["histogram"], figures["noise"]
    rows = [
        _row("level (ADU)", [match[f"{s}_level_adu"] for s in NAMES], f"bias {_text(match['bias_adu'])}"),
        _row("noise (ADU)", [match[f"{s}_noise_adu"] for s in NAMES], f"gain {_text(match['gain'])}"),
    ]
    for key, name in (("background", "source-free pixels"), ("all_pixels", "all pixels")):
        h = histogram[key]
        rows.append(_row(f"{name}: Wasserstein (noise units)", ("", ""), h["wasserstein_sigma"]))
        rows.append(_row(f"{name}: Bhattacharyya", ("", ""), h["bhattacharyya"]))
        rows.append(_row(f"{name}: KS", ("", ""), f"{_text(h['ks'])} (1 % point {_text(h['ks_one_percent'])})"))
    for key, name in (
        ("skewness", "skewness of the noise"),
        ("excess_kurtosis", "excess kurtosis of the noise"),
        ("beyond_5_sigma_per_mpx", "source-free pixels beyond 5 sigma, per Mpx"),
    ):
        rows.append(_row(name, histogram["background"][key]))
    if "reason" not in noise:
        rows.append(_row("noise spectrum: rms of ln(real / simulated)", ("", ""), noise["rms_log_ratio"]))
        rows.append(_row("row means, variance over white", noise["row_structure"]))
        rows.append(_row("column means, variance over white", noise["col_structure"]))
    return rows + _star_rows(figures)


def _star_rows(figures: dict[str, Any]) -> list[Row]:
    """Counts, widths and places of stars."""
    stars, psf, catalogue = figures["stars"], figures["psf"], figures["catalogue"]
    rows = [
        _row(f"stars above S/N {stars['counted_above_snr']:g}, per Mpx", [stars[s]["per_mpx"] for s in NAMES]),
        _row("slope of log N - log F", [stars[s]["slope"] for s in NAMES]),
        _row("trails", [stars[s]["trails"] for s in NAMES]),
        _row("fluxes of these stars: KS", ("", ""), stars["flux_ks"]["value"]),
    ]
    for key in ("fwhm_major_px", "fwhm_minor_px", "axis_ratio", "scatter_px"):
        rows.append(_row(f"PSF {key.replace('_', ' ')}", [psf[s][key] for s in NAMES]))
    rows.append(_row("PSF width: KS", ("", ""), psf["ks"]["value"]))
    pairs = catalogue["real_minus_simulated"]
    for key in ("in_field", "matched", "row_rms_px", "col_rms_px", "magnitude_scatter_mag"):
        both = pairs.get("n" if key == "matched" else key, "")
        cells = [catalogue[s].get(key, catalogue[s].get("reason")) for s in NAMES]
        rows.append(_row(f"catalogue stars: {key.replace('_', ' ')}", cells, both))
    return rows
