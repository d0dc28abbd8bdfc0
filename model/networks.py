"""Which network, settings and view of a release belong to a variant; the only place that knows both families of rankers."""

from __future__ import annotations

from collections.abc import Mapping

from model import local_settings, settings
from model.batches import encode_release
from model.errors import SettingsError
from model.grouping import Grouping
from model.inputs import ReleaseInputs
from model.local_ranker import LocalRanker
from model.local_release import encode_local
from model.local_settings import LocalSettings
from model.ranker import Ranker
from model.settings import RankerSettings, TrainingSettings, Variant

Network = Ranker | LocalRanker

_OF_THE_PAPER: Mapping[str, RankerSettings] = {
    named.name: named for named in (settings.FULL, settings.CPU, settings.CPU_PLACE, settings.LIGHT)
}
_LOCAL: Mapping[str, LocalSettings] = {named.name: named for named in (local_settings.FULL, local_settings.LIGHT)}


def settings_named(name: str, variant: Variant = Variant.FULL) -> TrainingSettings:
    """`full` or `light` of the variant's network, or `cpu` and `cpu_place` of the paper's; raises SettingsError on another name."""
    named: Mapping[str, TrainingSettings] = _LOCAL if variant.is_local else _OF_THE_PAPER
    if name not in named:
        raise SettingsError(f"setting {name!r}, must be one of {sorted(named)}")
    return named[name]


def settings_kind(variant: Variant) -> type[RankerSettings] | type[LocalSettings]:
    return LocalSettings if variant.is_local else RankerSettings


def build_network(chosen: TrainingSettings, variant: Variant, seed: int | None) -> Network:
    """The network of a variant, initialised by the seed, or without one left to be loaded; raises SettingsError on settings of another."""
    if variant.is_local and isinstance(chosen, LocalSettings):
        return LocalRanker(chosen, variant, seed)
    if not variant.is_local and isinstance(chosen, RankerSettings):
        return Ranker(chosen, variant, seed)
    raise _not_of(chosen, variant)


def encode(inputs: ReleaseInputs, chosen: TrainingSettings, variant: Variant) -> Grouping:
    """All candidates as the network of a variant reads them; raises SettingsError on settings of another."""
    if variant.is_local and isinstance(chosen, LocalSettings):
        return encode_local(inputs, chosen, variant)
    if not variant.is_local and isinstance(chosen, RankerSettings):
        return encode_release(inputs, chosen, variant)
    raise _not_of(chosen, variant)


def _not_of(chosen: TrainingSettings, variant: Variant) -> SettingsError:
    return SettingsError(f"settings of variant {variant.value}: {type(chosen).__name__}, must be {settings_kind(variant).__name__}")
