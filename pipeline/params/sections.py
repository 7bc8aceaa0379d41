"""The sections of params.yaml: what each field may be."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    StrictBool,
    field_validator,
    model_validator,
)
from pydantic_core import PydanticCustomError

from pipeline.errors import ParameterError, nearest, one_of
from pipeline.plug_ins import MODELS, SAMPLERS, installed_names
from pipeline.vocabulary import (
    CLOCKS,
    DEFORMATION,
    DEMONSTRATION_ANCHOR,
    GIVEN,
    INFERRED_MODELS,
    MIXTURE,
    PLANNER,
    RESERVED_FOLDERS,
    SCHEDULER,
    TASK_ANCHOR,
    VIA_POINT,
    Clock,
)
from schemas import schema

FILE = "params.yaml"
_PLACES = re.compile(r"\{participant\}|\{task\}|\*")
Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]
Positive = Annotated[float, Field(strict=True, gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(strict=True, ge=0, allow_inf_nan=False)]
Share = Annotated[float, Field(strict=True, ge=0, le=1)]
Cell = Annotated[int, Field(strict=True, ge=0, le=10)]
Finite = Annotated[float, Field(strict=True, ge=-1e9, le=1e9, allow_inf_nan=False)]


def _word_of(words: Iterable[str], group: str | None = None) -> BeforeValidator:
    """A check like that of `Literal`, with the same message, for words that are listed in the vocabulary.

    Installed packages add to them what they have in the `group` of `pipeline.plug_ins`.
    """
    allowed = tuple(words)

    def check(value: object) -> object:
        if value not in allowed and not (group and value in installed_names(group)):
            every = (*allowed, *(installed_names(group) if group else ()))
            listed = f"{', '.join(repr(word) for word in every[:-1])} or {every[-1]!r}"
            raise PydanticCustomError("literal_error", f"Input should be {listed}")
        return value

    return BeforeValidator(check, json_schema_input_type=Literal[allowed])  # for docs/parameters.md


AnchorWord = Annotated[str, _word_of((TASK_ANCHOR, DEMONSTRATION_ANCHOR))]
ClockWord = Annotated[Clock, _word_of(CLOCKS)]
ModelWord = Annotated[str, _word_of(INFERRED_MODELS, MODELS)]
SamplerWord = Annotated[str, _word_of((DEFORMATION, VIA_POINT, PLANNER, MIXTURE, GIVEN), SAMPLERS)]
SamplerKind = Annotated[str, _word_of((DEFORMATION, VIA_POINT, PLANNER, MIXTURE))]


def _frozen(mapping: dict[str, Any]) -> Mapping[str, Any]:
    return MappingProxyType(mapping)


Spec = Annotated[dict[str, str | float | int | bool], AfterValidator(_frozen)]
Specs = Annotated[dict[Name, Spec], Field(min_length=1), AfterValidator(_frozen)]
FeaturePath = Annotated[str, Field(pattern=r"^[A-Za-z0-9_./-]+\.py$")]  # as it stands in dvc.yaml
ScenePart = Annotated[str, Field(pattern=r"^[^$\x00-\x1f]+$", max_length=4096)]  # likewise, quoted
ThetaValues = Annotated[
    dict[Name, Annotated[tuple[Finite, ...], Field(min_length=1)]], Field(min_length=1), AfterValidator(_frozen)
]
Weights = Annotated[dict[Name, Finite], Field(min_length=1), AfterValidator(_frozen)]


_MET = ("scales", "posteriors", "densities", "alternatives", "demonstrations", "features")
"""Tables whose columns stand beside those of the features, in the program or in what people ask."""


def _distinct(values: tuple[Any, ...]) -> tuple[Any, ...]:
    if len(set(values)) != len(values):
        raise ValueError("the same value is listed twice; list each once")
    return values


def _refuse_parallel(thetas: tuple[tuple[float, ...], ...]) -> None:
    """Weights of one direction differ in beta alone, so that this direction would count twice in the prior."""
    seen = dict[tuple[float, ...], int]()
    for row, theta in enumerate(thetas):
        length = math.hypot(*theta)
        direction = tuple(round(value / length, 9) + 0.0 for value in theta) if length else theta
        if (other := seen.setdefault(direction, row)) != row:
            raise ValueError(
                f"thetas[{other}] and thetas[{row}] are the same direction, {list(theta)}, and would count twice; "
                "list each direction once, as beta says how much it counts"
            )


Renamed = Annotated[
    dict[str, str], BeforeValidator(lambda names: {} if names is None else names), AfterValidator(_frozen)
]
JointNames = (
    Annotated[str, Field(min_length=1)]
    | Annotated[tuple[Annotated[str, Field(min_length=1)], ...], Field(min_length=1), AfterValidator(_distinct)]
)


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=False)


JointName = Annotated[str, Field(min_length=1, max_length=200)]
Unit = Annotated[str, _word_of(("rad", "deg", "m", "mm"))]
Units = Annotated[dict[JointName, Unit], Field(min_length=1), AfterValidator(_frozen)]


class Reading(_Section):
    """How a task's recordings are read where they do not say so themselves; see docs/recordings.md.

    Attributes:
        time: name of the column that has the times.
        time_unit: unit of the times; null: taken from the name of the column and the size of the numbers.
        rate_hz: rows per second, for a table without times and for an HDF5 file.
        joints: names of the columns with positions, in order; for an array, the names of its columns.
        unit: unit of all positions, or of each joint; null: rad and m.
        array: name of the column or array that has all positions of a row.
        id: name of the column that says to which recording a row belongs.
        participant: name of the column that says whose recording it is.
        file_name: pattern of the names of files, such as `{participant}_*`.
    """

    time: JointName | None = None
    time_unit: Annotated[str, _word_of(("s", "ms", "us", "ns"))] | None = None
    rate_hz: Annotated[float, Field(strict=True, gt=0, le=1e6, allow_inf_nan=False)] | None = None
    joints: Annotated[tuple[JointName, ...], Field(min_length=1), AfterValidator(_distinct)] | None = None
    unit: Unit | Units | None = None
    array: JointName | None = None
    id: JointName | None = None
    participant: JointName | None = None
    file_name: Annotated[str, Field(min_length=1, max_length=200)] | None = None

    @field_validator("file_name")
    @classmethod
    def _pattern(cls, pattern: str | None) -> str | None:
        if pattern is not None:
            pieces = _PLACES.split(pattern)
            places = _PLACES.findall(pattern)
            if "{participant}" not in places and "{task}" not in places:
                raise ValueError(
                    f"{pattern!r} says nothing; it takes {{participant}} or {{task}}, and * for anything else, such as "
                    "'{participant}_*'"
                )
            if len(set(places) - {"*"}) < len([place for place in places if place != "*"]):
                raise ValueError(f"{pattern!r} has a place twice")
            if not all(pieces[1:-1]) or any(sign in piece for piece in pieces for sign in "{}"):
                raise ValueError(
                    f"{pattern!r} has places that nothing separates, or others than {{participant}}, {{task}} and *"
                )
        return pattern

    @model_validator(mode="after")
    def _fits(self) -> Reading:
        if self.time is not None and self.rate_hz is not None:
            raise ValueError("time and rate_hz both say when; give one of them")
        named = [name for name in (self.time, self.array, self.id, self.participant) if name is not None]
        if len(set(named)) < len(named) or set(named) & set(self.joints or ()):
            raise ValueError("a column has two meanings; each column is one of time, joints, array, id, participant")
        return self


class Task(_Section):
    """One task: a scene, where its recordings are, and what may matter in it.

    Attributes:
        scene: MJCF, URDF or YAML file of the scene. It has the keyframes `start` and `goal` if the anchor is `task`.
        scene_files: further files and folders that the scene depends on, so that DVC notices when they change.
        end_effector: body or site whose path matters.
        joints: joints of the arm: a list of names, or a body whose subtree has them. null: those that carry the end
            effector.
        joint_names: name in the recordings: name in the scene, for the joints where these differ.
        surface: site that sampled paths stay above; null: there is none.
        collisions: true: sampled paths have no contacts either, as MuJoCo computes them (slower).
        recordings: folder of recordings, or a dataset.
        anchor: `task`: alternatives start and end at the keyframes of the scene. `demonstration`: at the ends of each
            demonstration.
        features: what may matter to people, and what the robot looks at. Each has a name, a kind and the arguments of
            the kind.
        preferences: features that paths are planned for, by the planner sampler and the simulated people.
        feature_files: Python files that define further kinds of features.
        thetas: `grid`; or {feature: [values]}, the values of theta for some features of the grid (negative: a cost,
            positive: a wish); or a list of weight vectors.
    """

    scene: str
    scene_files: tuple[ScenePart, ...] = ()
    end_effector: str
    joints: JointNames | None = None
    joint_names: Renamed = Field(default_factory=dict, validate_default=True)
    surface: str | None
    collisions: StrictBool = False
    recordings: str
    reading: Reading | None = None
    anchor: AnchorWord
    features: Specs
    preferences: Specs
    feature_files: tuple[FeaturePath, ...] = ()
    thetas: Literal["grid"] | ThetaValues | tuple[tuple[Finite, ...], ...]

    @field_validator("features")
    @classmethod
    def _names_of_features(cls, features: Mapping[str, Any]) -> Mapping[str, Any]:
        taken = {column.name: table for table in _MET for column in schema(table).columns} | {"task": "every"}
        seen = dict[str, str]()
        for name in features:  # databases take names that differ in case for one
            if (lower := name.lower()) in taken:
                raise ValueError(
                    f"a feature cannot be called {name!r}, as {lower!r} is a column of the table "
                    f"{taken[lower]!r}; name it otherwise, such as 'my_{lower}'"
                )
            if (other := seen.setdefault(lower, name)) != name:
                raise ValueError(f"the features {other!r} and {name!r} differ in case alone; name them apart")
        return features

    @field_validator("joint_names")
    @classmethod
    def _each_joint_once(cls, names: Mapping[str, str]) -> Mapping[str, str]:
        for joint in names.values():
            if (recorded := [key for key, value in names.items() if value == joint])[1:]:
                raise ValueError(
                    f"{recorded[0]!r} and {recorded[1]!r} are both called {joint!r}; one joint has one name"
                )
        return names

    @model_validator(mode="after")
    def _theta_lengths(self) -> Task:
        if isinstance(self.thetas, Mapping):
            for name, values in self.thetas.items():
                if name not in self.features:
                    raise ValueError(
                        f"thetas names {name!r}, which is no feature of the task; there are {one_of(self.features)}"
                    )
                if len(set(values)) != len(values):
                    raise ValueError(f"thetas.{name} lists a value twice; list each once")
        elif self.thetas != "grid":
            if not self.thetas:
                raise ValueError("thetas holds no weight vector; give `grid` or at least one list of numbers")
            for row, theta in enumerate(self.thetas):
                if len(theta) != len(self.features):
                    raise ValueError(
                        f"thetas[{row}] has {len(theta)} numbers, needed is one for each of the {len(self.features)} "
                        f"features ({', '.join(self.features)})"
                    )
            _refuse_parallel(self.thetas)
        return self


class Simulate(_Section):
    """The simulated participants.

    Attributes:
        participants: simulated people per task.
        spread_rad: how far a person's weights are turned away from those of the task (standard deviation of each
            direction).
        skill: least and greatest skill of a person; with skill 1 the hand does not disturb the path.
        hand: `measured`: hands wander as those on recordings of people do (see `trajectories/measured_hand.py`);
            `skilled`: they follow the path that they intend, with small disturbances.
        topic: topic of the simulated recordings.
        extra_joints: further joints in the simulated recordings, such as fingers.
        weights: what the people of each simulated task want; each person has weights around these.
    """

    participants: Annotated[int, Field(strict=True, ge=1, le=10_000)]
    spread_rad: Annotated[float, Field(strict=True, ge=0, le=1)]
    skill: tuple[Share, Share]
    hand: Literal["measured", "skilled"] = "skilled"
    topic: str
    extra_joints: tuple[str, ...]
    weights: Annotated[dict[Name, Weights], AfterValidator(_frozen)]


class Ingest(_Section):
    """From recordings to demonstrations; the reasons for the limits are in docs/bring-your-own.md.

    Attributes:
        waypoints: T, the number of poses of a demonstration, evenly spaced in time.
        idle_rad: idle time at both ends is cut off: the time in which no joint moves further than this from where it
            rests.
        on_rejected: `stop`, or `continue` without the recordings that cannot be used.
        salvage: true: if a recording is cut off, use what was written before the cut.
        topic: topic that is read. null: the only one with the joints, or `.../joint_states`, or the one with clearly
            more messages.
        clock: `header`, `publish` or `log`: which times are used. null: the first of these that runs.
        far_ends: `reject` recordings that start or end far from the scene's keyframes (`anchor: task`), or `keep`
            them with a remark.
        far_rad: an end is far if a joint is this far from its keyframe ...
        far_m: ... and the end effector this far.
        fastest_rad_s: greatest speed of a hinge. Nobody who leads an arm by hand turns a hinge faster than a turn a
            second.
        fastest_m_s: greatest speed of a slide.
        longest_gap_s: longest time without a sample while the arm moves.
        longest_rest_s: longest rest within a demonstration. With a longer one, the recording holds more than one.
        jump_rad: from this on, a step of a hinge between two samples is a jump, if it is 8 times as far as the steps
            around it.
        jump_m: the same for a slide.
    """

    waypoints: Annotated[int, Field(strict=True, ge=3, le=10_000)]
    idle_rad: Positive
    on_rejected: Literal["stop", "continue"]
    salvage: StrictBool = False
    topic: Annotated[str, Field(min_length=1)] | None = None
    clock: ClockWord | None = None
    far_ends: Literal["reject", "keep"] = "reject"
    far_rad: Positive = 0.5
    far_m: Positive = 0.2
    fastest_rad_s: Positive = 6.3
    fastest_m_s: Positive = 3.0
    longest_gap_s: Positive = 0.5
    longest_rest_s: Positive = 3.0
    jump_rad: Positive = 0.3
    jump_m: Positive = 0.1


class Deformation(_Section):
    """See `pipeline.trajectories.samplers.Deformation`.

    Attributes:
        width_rad: root mean square deviation of each joint from the straight joint path.
        modes: half waves of each joint.
    """

    width_rad: Positive
    modes: Annotated[int, Field(strict=True, ge=1, le=1000)]


class ViaPoint(_Section):
    """See `pipeline.trajectories.samplers.ViaPoint`.

    Attributes:
        reach_rad: half width of the box around the straight joint path in which the via-point lies.
    """

    reach_rad: Positive


class Planner(_Section):
    """See `pipeline.trajectories.samplers.Planner`.

    Attributes:
        paths: paths that are planned for each anchor, each under random weights.
        width_rad: root mean square deformation that is added to a planned path.
    """

    paths: Annotated[int, Field(strict=True, ge=1, le=10_000)]
    width_rad: Positive


class Sample(_Section):
    """Which sets of alternatives are drawn, and how.

    Attributes:
        sizes: sizes of the independent sets.
        sets: independent sets of each size.
        working_set: size of the one set that is shown.
        sampler: `deformation`, `via-point` or `planner`; `mixture`: equal parts of these three; `given`: the
            trajectories of a file; or the sampler of an installed package.
        given: with `sampler: given`, a Parquet file whose column `waypoints` has the trajectories; else null.
        settings: arguments for the sampler of an installed package.
    """

    sizes: Annotated[tuple[Annotated[int, Field(strict=True, ge=2, le=100_000_000)], ...], Field()]
    sets: Annotated[int, Field(strict=True, ge=0, le=1000)]
    working_set: Annotated[int, Field(strict=True, ge=2, le=100_000_000)]
    sampler: SamplerWord
    given: str | None
    deformation: Deformation
    via_point: Annotated[ViaPoint, Field(alias=VIA_POINT)]
    planner: Planner
    settings: Spec = Field(default_factory=dict, validate_default=True)

    @model_validator(mode="after")
    def _settings_for_an_installed_sampler(self) -> Sample:
        if self.settings and self.sampler not in installed_names(SAMPLERS):
            raise ValueError(
                f"settings is for samplers of installed packages, and {self.sampler} has a section of its own"
            )
        return self

    @model_validator(mode="after")
    def _given_if_asked_for(self) -> Sample:
        if (self.sampler == GIVEN) != (self.given is not None):
            raise ValueError(
                f"sampler is {self.sampler} and given is {self.given}; the sampler `given` needs a file in `given`, "
                "the others need null there"
            )
        return self

    @field_validator("sizes")
    @classmethod
    def _each_once(cls, values: tuple[Any, ...]) -> tuple[Any, ...]:
        return _distinct(values)


class Compute(_Section):
    """How large sets of alternatives are computed.

    Attributes:
        partition: alternatives in one part. Larger sets go through the stages part by part.
        memory_gb: memory that a core may use to transform a part. More allows larger sets and narrower bandwidths.
    """

    partition: Annotated[int, Field(strict=True, ge=2, le=1_000_000)]
    memory_gb: Positive = 1.0

    @model_validator(mode="before")
    @classmethod
    def _no_scheduler(cls, section: Any) -> Any:
        if not isinstance(section, Mapping) or "scheduler" not in section:
            return section
        if section["scheduler"] is not None:
            raise ValueError(
                "scheduler is no parameter, as a scheduler can run code here, and parameters may come from others; "
                f"remove it, and name yours with `lessbench --scheduler` or in the environment, {SCHEDULER}"
            )
        return {key: value for key, value in section.items() if key != "scheduler"}  # null, as it once had to be


class Features(_Section):
    """How features are brought to one scale before models and kernels see them.

    Attributes:
        scale: what each feature is divided by: its `range` (largest minus least) or standard deviation (`std`) over
            the task's alternatives, nothing (`none`), or a number for each feature.
    """

    scale: Literal["range", "std", "none"] | Annotated[dict[Name, Positive], AfterValidator(_frozen)]


class Density(_Section):
    """The kernel density of the alternatives in feature space.

    Attributes:
        bandwidth: how the width of the kernel is chosen, see docs/method.md; or a number, in scaled features.
    """

    bandwidth: Literal["leave-one-out", "k-fold", "literal"] | Positive


class Infer(_Section):
    """The hypotheses and the models that are compared.

    Attributes:
        models: models that are compared.
        theta_values: with `thetas: grid`, the size of the weight of each feature. Every combination is a theta, with
            the sign by the kind of the feature, scaled to unit length.
        betas: values of beta: how strictly people optimise.
    """

    models: Annotated[tuple[ModelWord, ...], Field(min_length=1)]
    theta_values: Annotated[tuple[NonNegative, ...], Field(min_length=1)]
    betas: Annotated[tuple[Positive, ...], Field(min_length=1)]

    @field_validator("models", "betas")
    @classmethod
    def _each_once(cls, values: tuple[Any, ...]) -> tuple[Any, ...]:
        return _distinct(values)


class Explore(_Section):
    """How the choice space is explored, see docs/choice_space.md.

    Attributes:
        explorations: number of independent explorations, whose agreement is measured. 0: the choice space is not
            explored.
        evaluations: trajectories that each exploration looks at in the first round. They are doubled until the
            explorations agree.
        most_evaluations: greatest number of trajectories that each exploration looks at.
        tolerance: mean divergence of a pair of explorations (nats) up to which they agree.
        effort_multiple: greatest effort, as a multiple of the least possible. null: 1.25 times the multiple of the
            most wasteful demonstration.
        width_rad: width of the base measure. null: the demonstrations' deviation from their straight paths.
        modes: half waves of each joint around the straight path.
        largest_step: greatest step of a joint from one waypoint to the next, in rad or m. null: speed has no limit.
        cell: width of a cell of the map and of the kernel, in scaled features. null: derived.
    """

    explorations: Annotated[int, Field(strict=True, ge=0, le=100)] = 2
    evaluations: Annotated[int, Field(strict=True, ge=1, le=10**10)] = 250_000
    most_evaluations: Annotated[int, Field(strict=True, ge=1, le=10**10)] = 500_000
    tolerance: Positive = 0.02
    effort_multiple: Annotated[float, Field(strict=True, gt=1, allow_inf_nan=False)] | None = None
    width_rad: Positive | None = None
    modes: Annotated[int, Field(strict=True, ge=1, le=1000)] = 8
    largest_step: Positive | None = None
    cell: Positive | None = None

    @model_validator(mode="after")
    def _several(self) -> Explore:
        if self.explorations == 1:
            raise ValueError("explorations is 1; two or more can agree, and 0 explores nothing")
        if self.most_evaluations < self.evaluations:
            raise ValueError(
                f"most_evaluations is {self.most_evaluations}; it must be at least evaluations, {self.evaluations}"
            )
        return self


class ShiftedSampler(_Section):
    """One of the samplers that the alternatives come from under sampler shift.

    Attributes:
        kind: kind of sampler.
        width_rad: for a deformation: its root mean square deviation, as in `sample`.
        reach_rad: for a via-point: its reach, as in `sample`.
        paths: for a planner: paths that it plans, each under random weights of its own.
        of: for a mixture: names of the samplers that it has equal parts of.
    """

    kind: SamplerKind
    width_rad: Positive | None = None
    reach_rad: Positive | None = None
    paths: Annotated[int, Field(strict=True, ge=1, le=10_000)] | None = None
    of: Annotated[tuple[str, ...], Field(min_length=2)] | None = None

    @model_validator(mode="after")
    def _settings_of_its_kind(self) -> ShiftedSampler:
        needed = {DEFORMATION: "width_rad", VIA_POINT: "reach_rad", PLANNER: "paths", MIXTURE: "of"}[self.kind]
        given = sorted(self.model_dump(exclude={"kind"}, exclude_none=True))
        if given != [needed]:
            raise ValueError(f"a sampler of kind {self.kind} takes {needed} alone, got {', '.join(given) or 'nothing'}")
        return self


class Duplicates(_Section):
    """Near-copies that are slipped into sets of alternatives.

    Attributes:
        set_size: size of the independent sets that near-copies are added to.
        copied: how many alternatives of a set are copied, picked at random.
        copies: how many near-copies of each are added; one number per experiment.
        spreads: standard deviation of a copy's scaled features around those of the original; one number per
            experiment. 0: exact copies.
    """

    set_size: Annotated[int, Field(strict=True, ge=2)]
    copied: Annotated[int, Field(strict=True, ge=1, le=1_000_000)]
    copies: Annotated[tuple[Annotated[int, Field(strict=True, ge=1, le=10_000)], ...], Field(min_length=1)]
    spreads: Annotated[tuple[NonNegative, ...], Field(min_length=1)]


class Redraws(_Section):
    """Sets that are drawn again and again, see docs/twelve.md.

    Attributes:
        draws: how often the sets are drawn: each time `sample.sets` sets of every size.
        samplers: samplers, each of which is studied by itself.
    """

    draws: Annotated[int, Field(strict=True, ge=2, le=1000)]
    samplers: Annotated[dict[Name, ShiftedSampler], Field(min_length=1), AfterValidator(_frozen)]


class Regimes(_Section):
    """Ways to come by alternatives, side by side, see docs/choice_space.md.

    Attributes:
        optima: planned paths that are added to a set, for every theta.
        choices: choices of each simulated person.
        repetitions: simulated people for each theta and beta. Each set infers what they want.
    """

    optima: Annotated[int, Field(strict=True, ge=1, le=100)] = 3
    choices: Annotated[int, Field(strict=True, ge=1, le=1000)] = 12
    repetitions: Annotated[int, Field(strict=True, ge=1, le=1000)] = 3


class Robustness(_Section):
    """The study of how far a posterior depends on the alternatives that were sampled.

    Attributes:
        bandwidth_factors: multiples of the selected bandwidth, for the table `sensitivity`.
    """

    samplers: Annotated[dict[Name, ShiftedSampler], Field(min_length=2), AfterValidator(_frozen)]
    duplicates: Duplicates
    bandwidth_factors: Annotated[tuple[Positive, ...], Field(min_length=1)]
    redraws: Redraws | None = None
    regimes: Regimes = Field(default_factory=Regimes)

    @model_validator(mode="after")
    def _names_and_numbers(self) -> Robustness:
        for place, samplers in (("", self.samplers), ("redraws.", self.redraws.samplers if self.redraws else {})):
            simple = [name for name, sampler in samplers.items() if sampler.kind != MIXTURE]
            for name, sampler in samplers.items():
                unknown = sorted(set(sampler.of or ()) - set(simple))
                if unknown:
                    raise ValueError(
                        f"robustness.{place}samplers.{name}.of names {unknown[0]!r}; allowed are the others that are "
                        f"no mixtures: {one_of(simple)}"
                    )
        if self.duplicates.copied > self.duplicates.set_size:
            raise ValueError(
                f"robustness.duplicates.copied is {self.duplicates.copied}; a set has {self.duplicates.set_size}"
            )
        for key, values in (
            ("bandwidth_factors", self.bandwidth_factors),
            ("duplicates.copies", self.duplicates.copies),
            ("duplicates.spreads", self.duplicates.spreads),
        ):
            if len(set(values)) != len(values):
                raise ValueError(f"robustness.{key} lists a value twice; list each once")
        return self


class HumanChoice(_Section):
    """See `pipeline.studies.human_choice`.

    Attributes:
        choices: CSV file with a row for each choice.
        options: {group: [options on offer]}, if some options were never chosen; else null.
        alpha: level of Wellek's equivalence test.
        compare_with_paper: whether the results are compared with the paper's; false for your own choices.
    """

    choices: str
    options: Annotated[dict[str, tuple[str, ...]], AfterValidator(_frozen)] | None
    alpha: Annotated[float, Field(strict=True, gt=0, lt=0.5)]
    compare_with_paper: StrictBool


class GridWorldSettings(_Section):
    """The grid world; the paper publishes none of it but the number of seeds. All was chosen before the first run.

    Attributes:
        size: cells per side. 10 gives 48,620 paths, few enough to sum over all of them.
        objects: cells of the two objects. Mirror images in the diagonal from start to goal, so that neither is
            favoured, each midway between the centre and its corner of the grid, so that paths can pass on both sides.
        beta: inverse temperature of people and robot, on features scaled to a range of 1. 10, as log 48,620 = 10.8: the
            largest difference in reward then weighs about as much as the number of paths, and neither decides alone.
        demonstrations: paths per set. 5: the paper's examples speak of two demonstrations and several others.
        seeds: demonstration sets per theta and sampling model; 150 in the paper.
    """

    size: Annotated[int, Field(strict=True, ge=3, le=11)]
    objects: tuple[tuple[Cell, Cell], tuple[Cell, Cell]]
    beta: Positive
    demonstrations: Annotated[int, Field(strict=True, ge=1, le=10_000)]
    seeds: Annotated[int, Field(strict=True, ge=2, le=100_000)]

    @model_validator(mode="after")
    def _objects_on_the_grid(self) -> GridWorldSettings:
        corner = self.size - 1
        if any(coordinate > corner for cell in self.objects for coordinate in cell):
            raise ValueError(f"objects is {self.objects}; give two cells with coordinates from 0 to {corner}")
        return self


class FigureSettings(_Section):
    """How figures are drawn for print.

    Attributes:
        column_in: width of those that fit into a column, inches.
        text_in: width of those as wide as the page's text, inches.
        font_pt: size of text, points; titles are a fifteenth larger and ticks as much smaller. Heights grow with it.
        formats: what is written beside SVG, which the report and DVC show.
    """

    column_in: Annotated[float, Field(strict=True, ge=2, le=40, allow_inf_nan=False)] = 3.33
    text_in: Annotated[float, Field(strict=True, ge=4, le=80, allow_inf_nan=False)] = 7.0
    font_pt: Annotated[float, Field(strict=True, ge=4, le=40, allow_inf_nan=False)] = 7.5
    formats: Annotated[tuple[Literal["png", "pdf"], ...], AfterValidator(_distinct)] = ("png", "pdf")


class Studies(_Section):
    """The experiments that do not need a robot."""

    human_choice: HumanChoice
    grid_world: GridWorldSettings


class Params(_Section):
    """The whole of params.yaml."""

    seed: Annotated[int, Field(strict=True, ge=0, lt=1 << 63)]
    tasks: Annotated[dict[Name, Task], Field(min_length=1), AfterValidator(_frozen)]
    simulate: Simulate
    ingest: Ingest
    sample: Sample
    compute: Compute
    features: Features
    density: Density
    infer: Infer
    explore: Explore = Field(default_factory=Explore)
    robustness: Robustness
    studies: Studies
    figures: FigureSettings = Field(default_factory=FigureSettings)

    @model_validator(mode="after")
    def _across_sections(self) -> Params:
        for name in self.tasks:
            if name in RESERVED_FOLDERS:
                raise ValueError(
                    f"tasks.{name}: a task cannot be called {name!r}, as datasets/{name} is something else"
                )
        for name, weights in self.simulate.weights.items():
            if name not in self.tasks:
                raise ValueError(f"simulate.weights names the task {name!r}; there are {one_of(self.tasks)}")
            unknown = sorted(set(weights) - set(self.tasks[name].preferences))
            if unknown:
                raise ValueError(
                    f"simulate.weights.{name} names {unknown[0]!r}; allowed are the task's preferences "
                    f"{one_of(self.tasks[name].preferences)}"
                )
        return self

    def task(self, name: str) -> Task:
        """The task `name`.

        Raises:
            ParameterError: there is no such task.
        """
        if name not in self.tasks:
            raise ParameterError(
                f"there is no task {name!r} in {FILE}{nearest(name, self.tasks)}; there are {one_of(self.tasks)}"
            )
        return self.tasks[name]
