//! Where the stages meet Burn: its CPU backends and its autodiff. Kernels and twins know neither.

mod autodiff;
mod cpu;
mod host;
