"""The views of the catalog: answers to questions that people ask, each with what it says and what its columns are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class View:
    """A view: the tables it is made from, what it says, its select, and its columns that none of these tables has.

    Where not all of its tables are there but the first is, the view is made by `without`, if it has that.
    """

    tables: tuple[str, ...]
    comment: str
    select: str
    columns: Mapping[str, str] = field(default_factory=dict)
    without: str | None = None


# what is known of the files behind the tables; they have no file of their own
FILES, INPUTS = "files", "inputs"
PROVENANCE_TABLES: Mapping[str, tuple[str, Mapping[str, str]]] = {
    FILES: (
        "each row: one Parquet file that the catalog was made from",
        {
            "file": "path within the project",
            "table_name": "table of the catalog that its rows are in",
            "task": "task it belongs to; missing for the studies",
            "sha256": "of the file, as sha256sum prints it",
            "program": "program that wrote it, with its version",
            "seed": "of the random numbers in it; missing if there are none",
            "parameters": "SHA-256 of the parameters it depends on",
            "mujoco": "version of MuJoCo, if a scene had a part in it",
            "model": "hash of the compiled scene, likewise",
        },
    ),
    INPUTS: (
        "each row: one file that another was made from",
        {
            "file": "as in files",
            "input": "path within the project of what it was made from: a recording, a scene, another table",
            "sha256": "of the input when it was read, as sha256sum prints it",
        },
    ),
}
_KEYS = "task, demonstration_id, participant, model, set_size, set_id"
_SHOWN_KEYS = f"{_KEYS}, shown"
_HYPOTHESIS = "theta_id, theta, beta, log_posterior, posterior"
_SHOWN = {
    "shown": "whether this is the answer that figures and reports show: that over the explored choice space, or "
    "over the working set where there is no other"
}
_POSTERIOR = "of the most probable hypothesis (theta and beta)"

VIEWS: Mapping[str, View] = {
    "every_posterior": View(
        ("posteriors", "explored_posteriors"),
        "the posteriors over all sets of alternatives, and those over the explored choice space, pooled, with set_id "
        "`explored` and set_size 0, as it is no set",
        f"""select {_KEYS}, {_HYPOTHESIS},
                  set_id = 'working' and (task, model) not in (select distinct task, model from explored_posteriors)
                    as shown
           from posteriors
           union all by name
           select task, demonstration_id, participant, model, 0 as set_size, 'explored' as set_id, {_HYPOTHESIS},
                  true as shown
           from explored_posteriors where exploration = 'pooled'""",
        _SHOWN,
        f"select {_KEYS}, {_HYPOTHESIS}, set_id = 'working' as shown from posteriors",
    ),
    "best_hypothesis": View(
        ("posteriors",),
        "the most probable theta and beta of each demonstration (`all`: together), model and set; those of the "
        "explored choice space have set_id `explored`",
        f"""select {_SHOWN_KEYS},
                  arg_max(theta_id, log_posterior) as theta_id, arg_max(theta, log_posterior) as theta,
                  arg_max(beta, log_posterior) as beta, max(posterior) as posterior
           from every_posterior group by all order by all""",
        {"posterior": f"probability {_POSTERIOR}", **_SHOWN},
    ),
    "best_weights": View(
        ("posteriors", "scales"),
        "best_hypothesis with one row per feature, so that weights have names",
        f"""with named as (select task, list(feature order by rowid) as features from scales group by task)
           select {_SHOWN_KEYS}, unnest(features) as feature, unnest(theta) as weight, beta, posterior
           from best_hypothesis join named using (task)
           order by task, participant, demonstration_id, model, set_size, set_id, list_position(features, feature)""",
        {
            "weight": "of the feature in theta: reward per scaled unit; a cost is negative",
            "posterior": _POSTERIOR,
            **_SHOWN,
        },
    ),
    "theta_marginals": View(
        ("posteriors",),
        "the posterior over theta alone, beta summed out",
        f"""select {_SHOWN_KEYS}, theta_id, any_value(theta) as theta, sum(posterior) as posterior
           from every_posterior group by {_SHOWN_KEYS}, theta_id""",
        {"posterior": "probability of the theta; sums to 1 over theta", **_SHOWN},
    ),
    "beta_marginals": View(
        ("posteriors",),
        "the posterior over beta alone, theta summed out: how strictly people optimise",
        f"select {_SHOWN_KEYS}, beta, sum(posterior) as posterior from every_posterior group by {_SHOWN_KEYS}, beta",
        {"posterior": "probability of the beta; sums to 1 over beta", **_SHOWN},
    ),
    "beta_at_edge": View(
        ("posteriors",),
        "where the most probable beta of all demonstrations together is the first or last of the grid: either the "
        "grid is too short, or people choose at random",
        """select task, model, set_size, set_id, shown, arg_max(beta, posterior) as beta,
                  case when arg_max(beta, posterior) = min(beta) then 'least' else 'greatest' end as edge
           from beta_marginals where participant = 'all' group by task, model, set_size, set_id, shown
           having count(*) > 1 and arg_max(beta, posterior) in (min(beta), max(beta)) order by all""",
        {"edge": "`least` or `greatest` of the grid", **_SHOWN},
    ),
    "model_comparison": View(
        ("held_out",),
        "how well each model predicts a demonstration from the others, on the working set: log predictive probability, "
        "its mean per demonstration, and how much better that is than under Boltzmann",
        """select h.task, h.set_size, h.model, count(*) as demonstrations,
                  sum(h.log_predictive) as total, avg(h.log_predictive) as mean,
                  stddev_samp(h.log_predictive) / sqrt(count(*)) as standard_error,
                  avg(h.log_predictive - b.log_predictive) as difference,
                  stddev_samp(h.log_predictive - b.log_predictive) / sqrt(count(*)) as difference_standard_error
           from held_out h left join held_out b
             on b.model = 'boltzmann' and (b.task, b.demonstration_id, b.set_size, b.set_id)
                                        = (h.task, h.demonstration_id, h.set_size, h.set_id)
           where h.set_id = 'working' group by h.task, h.set_size, h.model order by all""",
        {
            "demonstrations": "how many were predicted, each from all others",
            "total": "log predictive probability of all, summed [nat]",
            "mean": "log predictive probability per demonstration [nat]",
            "standard_error": "of the mean [nat]",
            "difference": "mean less that of Boltzmann, demonstration by demonstration [nat]; missing without "
            "Boltzmann",
            "difference_standard_error": "of the difference [nat]",
        },
    ),
    "disagreement_between_sets": View(
        ("posteriors",),
        "how much the answer depends on which alternatives were drawn: best theta and posterior over theta, compared "
        "between the sets of one size (without the working set and the explored choice space); KLAggregate is in "
        "the table robustness",
        f"""with one as (select * from theta_marginals where set_id not in ('working', 'explored')),
                pairs as (
                  select task, demonstration_id, participant, model, set_size, a.set_id as first, b.set_id as second,
                         sum(abs(a.posterior - b.posterior)) / 2 as variation
                  from one a join one b using (task, demonstration_id, participant, model, set_size, theta_id)
                  where a.set_id < b.set_id group by all),
                apart as (
                  select task, demonstration_id, participant, model, set_size,
                         avg(variation) as mean_total_variation, max(variation) as largest_total_variation
                  from pairs group by all),
                votes as (
                  select task, demonstration_id, participant, model, set_size, theta_id, count(*) as sets
                  from (select {_KEYS}, arg_max(theta_id, posterior) as theta_id from one group by {_KEYS})
                  group by all)
           select task, demonstration_id, participant, model, set_size, sum(sets)::bigint as sets, count(*) as answers,
                  max(sets) / sum(sets) as agreeing, any_value(mean_total_variation) as mean_total_variation,
                  any_value(largest_total_variation) as largest_total_variation
           from votes left join apart using (task, demonstration_id, participant, model, set_size)
           group by all order by all""",
        {
            "sets": "how many sets of this size were compared",
            "answers": "how many different most probable thetas (beta summed out) they give",
            "agreeing": "share of the sets that give the most frequent of these",
            "mean_total_variation": "total variation distance of two sets' posteriors over theta, mean over pairs: 0 "
            "is the same, 1 is nothing in common; missing for one set",
            "largest_total_variation": "the largest over pairs; missing for one set",
        },
    ),
    "disagreement_between_models": View(
        ("posteriors",),
        "whether two models say the same of the same demonstrations and alternatives",
        """select task, demonstration_id, participant, set_size, set_id, a.shown and b.shown as shown, a.model,
                  b.model as other_model,
                  arg_max(theta_id, a.posterior) as theta_id, arg_max(theta_id, b.posterior) as other_theta_id,
                  sum(abs(a.posterior - b.posterior)) / 2 as total_variation
           from theta_marginals a
           join theta_marginals b using (task, demonstration_id, participant, set_size, set_id, theta_id)
           where a.model < b.model group by all order by all""",
        {
            **_SHOWN,
            "other_model": "the model it is compared with",
            "other_theta_id": "most probable theta under that one",
            "total_variation": "total variation distance of the posteriors over theta: 0 is the same, 1 nothing in "
            "common",
        },
    ),
    "people_against_group": View(
        ("posteriors",),
        "what each demonstration says, beside what all together say",
        f"""select {", ".join("one." + name for name in _SHOWN_KEYS.split(", "))}, one.theta_id, one.theta,
                  pooled.theta_id as group_theta_id, pooled.theta as group_theta,
                  one.theta_id <> pooled.theta_id as differs,
                  degrees(acos(greatest(-1, least(1, list_cosine_similarity(one.theta, pooled.theta))))) as angle_deg
           from best_hypothesis one join best_hypothesis pooled using (task, model, set_size, set_id)
           where one.demonstration_id <> 'all' and pooled.participant = 'all'
           order by all""",
        {
            **_SHOWN,
            "group_theta_id": "most probable theta of all demonstrations together",
            "group_theta": "its weights",
            "differs": "whether the two are different thetas",
            "angle_deg": "angle between them [deg]",
        },
    ),
    "recordings": View(
        ("demonstrations", "rejected"),
        "every recording of every task: used as which demonstration, or why not",
        """select task, source, true as used, demonstration_id, participant, null as reason, null as detail
           from demonstrations
           union all by name select task, source, false as used, reason, detail from rejected
           order by task, source""",
        {"used": "whether it became a demonstration"},
    ),
    "lineage": View(
        ("posteriors", "demonstrations"),
        "from each posterior back to the recordings it is inferred from, one row per recording, with the hashes of "
        "what it was made from; joins every_posterior on its first six columns",
        f"""with asked as (select distinct {_KEYS} from every_posterior),
                demo_files as (select task, file from files where table_name = 'demonstrations'),
                posterior_files as (select * from files where table_name in ('posteriors', 'explored_posteriors'))
           select asked.*, d.demonstration_id as recorded_as, i.input as recording, i.sha256 as recording_sha256,
                  f.file as posterior_file, f.sha256 as posterior_sha256, f.parameters, f.program
           from asked
           join demonstrations d on d.task = asked.task and (d.demonstration_id = asked.demonstration_id
             or asked.demonstration_id = 'all' and asked.participant in ('all', d.participant))
           left join demo_files on demo_files.task = asked.task
           left join inputs i on i.file = demo_files.file
               and (i.input = d.source or ends_with(i.input, '/' || d.source)
                    or ends_with(i.input, '/' || regexp_replace(d.source, ': [^/:]*$', '')))
           left join posterior_files f on f.task = asked.task
               and (f.table_name = 'explored_posteriors') = (asked.set_id = 'explored') order by all""",
        {
            "recorded_as": "demonstration_id of the recording",
            "recording": "path of the recording within the project",
            "recording_sha256": "of the recording when it was read, as sha256sum prints it",
            "posterior_file": "Parquet file that the posterior is in",
            "posterior_sha256": "of that file",
            "parameters": "SHA-256 of the parameters that inference depends on",
            "program": "program that inferred it, with its version",
        },
    ),
    "derived_from": View(
        (),
        "all files that a file was made from, directly or through others, down to recordings and scenes",
        """with recursive up as (
             select file, input as origin, sha256, 1 as steps from inputs
             union all
             select up.file, i.input, i.sha256, up.steps + 1 from up join inputs i on i.file = up.origin)
           select file, origin, sha256, min(steps) as steps from up group by all
           order by file, steps, origin""",
        {
            "file": "as in files",
            "origin": "path of a file that it goes back to",
            "sha256": "of that one when it was read",
            "steps": "how many stages lie between, 1 is directly",
        },
    ),
    "outdated": View(
        (),
        "tables that were made from another version of a table than the one that is there now; `dvc repro` mends it",
        """select made.file, made.input, made.sha256 as was, now.sha256 as is_now
           from inputs made join files now on now.file = made.input where made.sha256 <> now.sha256
           order by all""",
        {
            "file": "the table that is out of date",
            "input": "the table it was made from",
            "was": "SHA-256 of that table when it was read",
            "is_now": "and now",
        },
    ),
}
