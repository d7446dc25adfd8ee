"""How the documentation is built: `make docs`, or `sphinx-build -W -n docs build/docs`."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE / "_ext"), str(HERE.parent)]

from sparsefit import __version__  # noqa: E402

project = "sparsefit"
author = "the sparsefit authors"
copyright = "the sparsefit authors, MIT licence"
version = release = __version__

extensions = [
    "myst_parser",
    "sphinx_design",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
    "matplotlib.sphinxext.plot_directive",
    "directives",
]
# Pictures are drawn when the page is built, from the top of the repository.
plot_formats = ["svg"]
plot_html_show_formats = plot_html_show_source_link = False
plot_working_directory = str(HERE.parent)
plot_apply_rcparams = True
plot_rcparams = {
    "font.size": 10.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "svg.fonttype": "none",
    "svg.hashsalt": "sparsefit",
    "font.family": "sans-serif",
    "figure.constrained_layout.use": True,
    "savefig.facecolor": "white",
    "savefig.bbox": "tight",
}
exclude_patterns = ["_ext", "_static", "_templates", "pictures"]
templates_path = ["_templates"]
myst_enable_extensions = ["dollarmath", "colon_fence", "deflist"]
myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented_params"
autodoc_preserve_defaults = True
python_use_unqualified_type_names = True
add_module_names = False
default_role = "code"
copybutton_prompt_text = r"\$ |>>> "
copybutton_prompt_is_regexp = True
smartquotes = False  # --option stays what is typed
toc_object_entries_show_parents = "hide"
autodoc_default_options = {
    "exclude-members": "set_fit_request, set_predict_request, set_score_request, "
    "set_transform_request"
}
# Types are words here: many are of other packages, or of records that users meet but do not make.
nitpick_ignore_regex = [("py:(class|exc|func|obj|data)", ".*")]

html_theme = "pydata_sphinx_theme"
html_title = f"sparsefit {version}"
html_static_path = ["_static"]
html_css_files = ["sparsefit.css"]
html_show_sphinx = False
html_copy_source = False
html_math_renderer = "mathml"
html_sidebars = {"**": ["contents.html"]}
html_theme_options = {
    "navigation_with_keys": False,
    "show_prev_next": True,
    "secondary_sidebar_items": ["page-toc"],
    "navbar_center": [],
    "primary_sidebar_end": [],
    "footer_start": ["copyright"],
    "footer_end": [],
    "pygments_light_style": "tango",
    "pygments_dark_style": "monokai",
}
