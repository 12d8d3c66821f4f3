//! The `rigsmith` program: parse, call the library, say what happened.

fn main() {}
