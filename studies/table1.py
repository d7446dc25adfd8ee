"""The paper's Fig. 1: the weight of every candidate length scale on its one flight."""

from sparsefit.plot.style import COLOURS, labels, panels


def weights(cases, study):
    """Return the weights of the first setting of each back-end, with the true and chosen scale."""
    shown = cases.drop_duplicates(["protocol", "backend"])
    figure, grid = panels(len(shown), 1, height=0.6 + 1.3 * len(shown))
    titles = labels(list(shown["title"]), 80)
    kept = study.weights.groupby("case_id")
    for (axes,), (_, case) in zip(grid, shown.iterrows(), strict=True):
        own = kept.get_group(case["case_id"])
        axes.vlines(own["length_scale"], 0.0, own["weight"], color=COLOURS[0], label="weight")
        axes.axvline(case["true_length_scale"], color=COLOURS[1], ls="--", label="true")
        axes.axvline(case["grid_length_scale"], color=COLOURS[2], ls=":", label="chosen")
        axes.set_title(titles[case["title"]], loc="left")
        axes.sharex(grid[0][0])
    axes.set_xlabel("candidate length scale [m]")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper right", ncols=3)
    return figure
