"""What is odd about frames, codes and coordinates, and what comes of it: a refusal, or a sentence for the operator."""
