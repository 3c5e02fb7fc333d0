"""The camera as built: departures from the nominal camera, drawn by seed where the options ask for it."""

from dataclasses import replace

from simulator.options import SimulatorOptions
from simulator.randomness import Effect, generator

_DRAWN = ("focal_length_ppm", "center_row_px", "center_col_px", "distortion", "zero_point_mag", "psf_width", "colour_term")


def with_drawn_errors(options: SimulatorOptions, seed: int) -> SimulatorOptions:
    """Options whose departures are draws of the seed: normal, with the values given as their sigmas; the same without `drawn`.

    The errors of the two gains, of the linearity and of the camera file's seeing are drawn with them.
    """
    built = options.instrument.as_built
    if not built.drawn:
        return options
    rng = generator(seed, Effect.AS_BUILT)
    drawn = {name: getattr(built, name) * float(rng.standard_normal()) for name in _DRAWN}
    drawn["psf_width"] = max(drawn["psf_width"], -0.5)
    converter, atmosphere = options.sensor.converter, options.atmosphere
    gain, low_gain, seeing, linearity = (float(x) for x in rng.standard_normal(4))
    return replace(
        options,
        instrument=replace(options.instrument, as_built=replace(built, **drawn, drawn=False)),
        sensor=replace(
            options.sensor,
            converter=replace(
                converter,
                gain_error=max(converter.gain_error * gain, -0.5),
                low_gain_error=max(converter.low_gain_error * low_gain, -0.5),
                nonlinearity_error=max(converter.nonlinearity_error * linearity, -1.0),
            ),
        ),
        atmosphere=replace(atmosphere, seeing_error=max(atmosphere.seeing_error * seeing, -0.5)),
    )
