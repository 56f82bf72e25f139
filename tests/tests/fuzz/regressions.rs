//! Inputs that a reader once failed on, or that none may ever fail on.
