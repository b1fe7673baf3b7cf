#![doc = concat!(include_str!("links.md"), "\n", include_str!("README.md"))]

macro_rules! chapters {
    ($($name:ident)*) => {
        $(
            // Each chapter can also be read as a file: its own links lead to files. Of two
            // definitions of a link the first counts, so here links lead to items, and pictures,
            // which rustdoc does not copy, are inlined.
            #[doc = concat!(
                include_str!("pictures/definitions.md"),
                include_str!("links.md"),
                "\n",
                include_str!(concat!(stringify!($name), ".md"))
            )]
            pub mod $name {}
        )*
    };
}

chapters! {
    polling trust recovery baud_rates geometry models time testing operating logging common_issues
    recipes design rationale
}
