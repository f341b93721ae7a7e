"""How uncertain a fitted number is: noise that remembers, and linear fits that know it."""
