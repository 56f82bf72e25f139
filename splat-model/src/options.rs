//! Structs of options, each with its default, and enums of named values.

/// Declares a struct of options that files may name in part: the default of each is after its `=`.
macro_rules! options {
    ($(#[$about:meta])* pub struct $name:ident {
        $($(#[$of_field:meta])* pub $field:ident: $kind:ty = $default:expr,)*
    }) => {
        $(#[$about])*
        #[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
        #[serde(default, deny_unknown_fields)]
        pub struct $name {
            $($(#[$of_field])* pub $field: $kind,)*
        }

        impl Default for $name {
            fn default() -> Self {
                Self { $($field: $default,)* }
            }
        }
    };
}

/// Declares an enum of which each value has a name, after its `=`.
macro_rules! named {
    ($(#[$about:meta])* pub enum $kind:ident {
        $($(#[$of_value:meta])* $value:ident = $name:literal,)*
    }) => {
        $(#[$about])*
        pub enum $kind {
            $($(#[$of_value])* $value,)*
        }

        impl $kind {
            /// All values, in the order of their declaration.
            pub const ALL: [Self; [$($name),*].len()] = [$(Self::$value),*];

            /// The name in files and messages and on command lines.
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$value => $name,)*
                }
            }
        }

        impl std::fmt::Display for $kind {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str(self.name())
            }
        }
    };
}
