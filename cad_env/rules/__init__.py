"""Rule-based policies: on the truth, on what is known, and cautious about what is hidden."""
