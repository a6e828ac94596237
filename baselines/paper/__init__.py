"""The tables and plots that stand beside the paper's, with their uncertainty, from the folder of a run."""
