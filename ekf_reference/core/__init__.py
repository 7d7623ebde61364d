"""The filter: state, landmark types, measurement update, the step, and its trace."""
