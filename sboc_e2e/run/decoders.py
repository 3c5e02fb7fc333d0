"""Which decoders read the packets of a scenario: the chosen one, that of its codec, and every one that comes with the project."""

from sboc_e2e.icd.errors import UserError
from sboc_e2e.icd.steps import Decoder
from sboc_e2e.registry import Registry, own_names
from sboc_e2e.scenario import Scenario


def decoders_of(scenario: Scenario) -> tuple[Decoder, ...]:
    """One decoder for each codec number, the chosen one first; the decoder that comes with a codec from outside is among them."""
    registry = Registry()
    codec = scenario.components["onboard.codec"]
    shipped = (registry.resolve("ground.decoder", name)() for name in own_names("ground.decoder"))
    by_number: dict[int, Decoder] = {}
    for decoder in (scenario.step("ground.decoder"), registry.decoder_for(codec.name, codec.step), *shipped):
        if decoder is not None:
            by_number.setdefault(int(decoder.number), decoder)
    return tuple(by_number.values())


def require_decoder(scenario: Scenario) -> None:
    """Refuse a codec whose blocks nothing on ground could read, before hours of work and not by a score of zero."""
    codec = scenario.components["onboard.codec"]
    known = sorted(int(decoder.number) for decoder in decoders_of(scenario))
    if int(codec.step.number) not in known:
        raise UserError(
            f"onboard.codec: {codec.name} writes blocks of codec number {codec.step.number}, which no decoder reads (there are "
            f"{', '.join(map(str, known))}): put one into its module, install one under its name, or name one with ground.decoder"
        )
