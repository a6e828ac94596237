"""How every learned method is trained."""
