"""Where a real car and a real robot are: what can be known from recordings of others, and what cannot."""
