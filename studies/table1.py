"""The paper's Fig. 1: the weight of every candidate length scale on its one flight."""

from sparsefit.plot.style import COLOURS, labels, panels


def weights(cases, study):
    """Return the weights of the first setting of each back-end, with the true and chosen scale."""
    shown = cases.drop_duplicates(["protocol", "backend"])
    figure, grid = panels(len(shown), 1, height=0.6 + 1.3 * len(shown))
    titles = labels(list(shown["title"]), 80)
    for (axes,), (_, case) in zip(grid, shown.iterrows(), strict=True):
        scales, sizes = zip(*sorted(study.again(case["case_id"]).estimate.weights_by_scale.items()))
        sizes = [float(f"{size:.3g}") for size in sizes]  # what any machine computes
        axes.vlines(scales, 0.0, sizes, color=COLOURS[0], label="weight")
        axes.axvline(case["true_length_scale"], color=COLOURS[1], ls="--", label="true")
        axes.plot(case["grid_length_scale"], 1.0, "v", color=COLOURS[2], label="chosen",
                  transform=axes.get_xaxis_transform(), clip_on=False)  # fmt: skip
        axes.set_title(titles[case["title"]], loc="left")
        axes.sharex(grid[0][0])
    axes.set_xlabel("candidate length scale [m]")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper right", ncols=3)
    return figure
