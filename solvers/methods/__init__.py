"""How a line is marched. Methods know the contract's verbs and no line."""
