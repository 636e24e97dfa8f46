"""How well missing physics is found on four vehicles that nothing was tuned for."""
