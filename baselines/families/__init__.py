"""The networks that the paper's own is compared with, as families: a module or two each."""
