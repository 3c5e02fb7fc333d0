"""After a run's last frame: what its tracker finds when no frame follows."""

from onboard.downlink.budget import Outbox, elapsed_s
from onboard.downlink.send import send_tracks
from onboard.guard import guarded
from onboard.options import RoiOptions
from onboard.state import OnboardState, OnboardSteps, RunEnd
from sboc_e2e.icd.results import check_tracks
from sboc_e2e.icd.steps import Encoder, FinishingTracker, GainAwareEncoder


def run_end(state: OnboardState, steps: OnboardSteps, options: RoiOptions, psf_sigma_px: float) -> RunEnd:
    """The tracker's last tracks and their packets. They are the last frame's, with the downlink's time of one more exposure."""
    step, tracking, last = steps.tracker, state.tracking, state.previous
    if tracking is None or last is None or not tracking.pixels.kept or not isinstance(step, FinishingTracker):
        return RunEnd()
    kept = tracking.pixels.kept
    tracks = guarded("tracker", step, step.finish, tracking.step)
    guarded("tracker", step, check_tracks, tracks, {frame.header.frame: frame.shape for frame in kept})
    outbox = Outbox(writer=state.writer, allowance=state.allowance.after(elapsed_s(last, None)), header=last)
    send_tracks(tracks, tracking.pixels, outbox, codec_of(steps.codec, kept[-1].adu_scale), options, psf_sigma_px)
    return RunEnd(packets=outbox.joined(), tracks=tuple(tracks))


def codec_of(codec: Encoder, adu_scale: float) -> Encoder:
    """The codec as a frame needs it of which one count is `adu_scale` ADU."""
    if adu_scale == 1.0 or not isinstance(codec, GainAwareEncoder):
        return codec
    scaled: Encoder = guarded("codec", codec, codec.for_counts, adu_scale)
    return scaled
