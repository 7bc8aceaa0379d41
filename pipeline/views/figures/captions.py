"""A caption for each figure, in the order in which the report shows them."""

from __future__ import annotations

from collections.abc import Mapping

TASK_FIGURES: Mapping[str, str] = {
    "posterior": "What all demonstrations together say: the posterior over the weights under each model, summed over "
    "beta. It rests on the explored choice space where there is one. Of simulated people the hypothesis nearest to "
    "what they truly want is marked true.",
    "held_out": "How well each model predicts a demonstration from all others: log predictive probability, and how "
    "much better than Boltzmann. Dots are demonstrations, bars one standard error of the mean.",
    "density_map": "Density of the alternatives over the two features that weigh most, as sampled and after LESS has "
    "divided their weight by the density around them, with the demonstrations. Both panels have the same colours.",
    "densities": "Density of the alternatives along each feature, as sampled and after LESS has divided their weight "
    "by the density around them. Ticks are demonstrations.",
    "robustness": "How much posteriors differ between ten sets of alternatives (KLAggregate, here as the mean of a "
    "pair of sets; lower is more robust) against the size of the sets: sets of one sampler, and sets of ten different "
    "samplers. Bars are 95 % intervals; an arrow marks one that goes on.",
    "accuracy": "Of simulated participants, whose true weights are known: the angle from the most probable weights to "
    "the true ones, and the probability given to the hypothesis nearest to them, against the size of the sets. Bars "
    "are 95 % intervals: over participants, and of all together over the sets.",
    "duplicates": "Near-copies of some alternatives are added to a set. How far does that move the posterior (KL "
    "divergence from the set without copies)? Spread is how far copies lie from their originals: the standard "
    "deviation of each scaled feature, whose range among the alternatives is 1 by default.",
    "sensitivity": "KLAggregate per pair when one setting of the study is changed, and in what share of the sets the "
    "most probable weights of all together are then others. An arrow marks a value outside the panel.",
}
FURTHER_FIGURES: Mapping[str, str] = {
    "scene": "The scene, with the arm where motions start, and where people led its end effector. Dotted is "
    "what something hides.",
    "predicted": "What the next person is predicted to do: for each feature the median and the interval of probability "
    "0.9 under each model, and what people did (ticks).",
    "regions": "Where each sampler of the study draws, and what the choice space reaches, along the two features that "
    "weigh most. Each sampler covers another part.",
    "ten_posteriors": "The posterior of the first demonstration from each sampler's largest set, and from each "
    "exploration of the choice space, each from seeds of its own: a mark each. Where marks coincide, they agree.",
    "importance": "Samplers whose density is known. Each alternative is weighted by one over that density: how robust "
    "Boltzmann then is, and how few alternatives carry most of the weight. An arrow marks an interval that goes on.",
    "two_posteriors": "The posterior of one demonstration from two sets of alternatives: where the bars of a pair "
    "differ, the answer depends on which alternatives were drawn.",
}
"""Shown in the report beside the others, and not by `dvc plots`."""
STUDY_FIGURES: Mapping[str, str] = {
    "human_choice": "What people chose, and what each model predicts. Bars are exact 95 % intervals of the observed "
    "share.",
    "grid_world_true_posterior": "Grid world: probability of the true weights after a set of demonstrations, by the "
    "true weights, the model by which people choose, and the model that infers.",
    "grid_world_overall": "The mean over all true weights, also for people who see features that the robot does not.",
    "grid_world_sets": "Two sets of demonstrations and the posteriors from them. Paths that share a step are drawn "
    "side by side.",
    "grid_world_density": "Density of all paths along each feature and over both, with the two sets.",
}
CAPTIONS = {**TASK_FIGURES, **FURTHER_FIGURES, **STUDY_FIGURES}
