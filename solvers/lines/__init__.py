"""What is modelled: one room per line. Lines never import methods or one another."""
