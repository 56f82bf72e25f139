//! Records: what an operation takes, in named fields of one kind, whatever that kind is.

/// Declares a record. The same fields hold tensors of a backend, slices, buffers of a device, what is wanted of each, or what was
/// found for it, so the way from one form to the next is a map and no list of fields.
///
/// The gradient of an input is the field of the same name, and has its shape.
macro_rules! record {
    ($(#[$meta:meta])* pub struct $name:ident { $($(#[$field_meta:meta])* $field:ident,)* }) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
        pub struct $name<T> {
            $($(#[$field_meta])* pub $field: T,)*
        }

        impl<T> $name<T> {
            /// Each field in another form.
            pub fn map<U>(self, mut f: impl FnMut(T) -> U) -> $name<U> {
                $name { $($field: f(self.$field),)* }
            }

            /// References to the fields.
            pub fn each_ref(&self) -> $name<&T> {
                $name { $($field: &self.$field,)* }
            }

            /// Each field beside that of another record.
            pub fn zip<U>(self, other: $name<U>) -> $name<(T, U)> {
                $name { $($field: (self.$field, other.$field),)* }
            }

            /// The fields in the order of their declaration.
            pub fn into_array(self) -> [T; [$(stringify!($field)),*].len()] {
                [$(self.$field,)*]
            }

            /// A record of fields in the order of their declaration.
            pub fn from_array(fields: [T; [$(stringify!($field)),*].len()]) -> Self {
                let [$($field,)*] = fields;
                Self { $($field,)* }
            }
        }
    };
}

pub(crate) use record;
