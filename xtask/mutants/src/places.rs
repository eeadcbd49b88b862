//! Places of a source file that a mutant can change, found in its syntax tree.

use std::ops::Range;

use anyhow::{Context as _, Result, ensure};
use proc_macro2::Span;
use syn::spanned::Spanned as _;
use syn::visit::{self, Visit};
use syn::{BinOp, Expr, ExprBinary, Lit, Stmt, UnOp};

/// Path of the switch in the mutated tree.
const ON: &str = "::foretorque::mutation::on";

/// Operators, and the two that may take the place of each: of a comparison, one at its boundary and the opposite.
#[rustfmt::skip]
const OPERATORS: [(&str, [&str; 2]); 16] = [
    ("<", ["<=", ">="]), ("<=", ["<", ">"]), (">", [">=", "<="]), (">=", [">", "<"]),
    ("==", ["!="; 2]), ("!=", ["=="; 2]),
    ("+", ["-"; 2]), ("-", ["+"; 2]), ("*", ["/"; 2]), ("/", ["*"; 2]), ("%", ["/"; 2]),
    ("&", ["|"; 2]), ("|", ["&"; 2]), ("^", ["&"; 2]), ("<<", [">>"; 2]), (">>", ["<<"; 2]),
];

/// Insertion, or replacement of `at`; `#` in the text stands for the call of the switch.
#[derive(Clone, Debug)]
struct Edit {
    at: Range<usize>,
    text: String,
    /// Closes what an earlier edit of the same place has opened.
    closes: bool,
}

impl Edit {
    fn new(at: Range<usize>, text: &str, closes: bool) -> Self {
        let text = text.to_owned();
        Self { at, text, closes }
    }
}

/// One mutant: an expression or statement of a function, and its change behind a switch.
#[derive(Clone, Debug)]
pub(crate) struct Place {
    /// Bytes of the expression in the file.
    pub(crate) span: Range<usize>,
    pub(crate) function: String,
    /// The change and its text, on one line.
    pub(crate) change: String,
    edits: Vec<Edit>,
}

impl Place {
    /// Replacement of a text that occurs once, apart from whitespace; of the part between «», where it has these marks.
    pub(crate) fn named(text: &str, from: &str, to: &str) -> Result<Self> {
        let letters: Vec<(usize, char)> = text
            .char_indices()
            .filter(|(_, letter)| !letter.is_whitespace())
            .collect();
        let wanted: Vec<char> = from.chars().filter(|c| !c.is_whitespace()).collect();
        let marks = ['«', '»'];
        let plain: Vec<char> = wanted
            .iter()
            .copied()
            .filter(|c| !marks.contains(c))
            .collect();
        let fits = |place: &[(usize, char)]| place.iter().map(|(_, c)| c).eq(&plain);
        let mut found = letters.windows(plain.len()).filter(|place| fits(place));
        let place = found.next().context("the text does not occur")?;
        ensure!(found.next().is_none(), "the text occurs twice");
        let first = wanted.iter().position(|&c| c == '«').unwrap_or(0);
        let end = wanted
            .iter()
            .position(|&c| c == '»')
            .map_or(plain.len(), |end| end - 1);
        let (end, letter) = place[end - 1];
        let span = place[first].0..end + letter.len_utf8();
        let statement = text[span.clone()].ends_with([';', '}']);
        let (open, close) = if statement { ("", "") } else { ("(", ")") };
        let head = format!("{open}if # {{ {to} }} else {{ ");
        let edits = wrapped(&span, &head, &format!(" }}{close}"));
        Ok(Self {
            span,
            function: String::new(),
            change: String::new(),
            edits,
        })
    }
}

fn wrapped(span: &Range<usize>, head: &str, tail: &str) -> Vec<Edit> {
    vec![
        Edit::new(span.start..span.start, head, false),
        Edit::new(span.end..span.end, tail, true),
    ]
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// All places of a file, in its order.
pub(crate) fn of(text: &str) -> Result<Vec<Place>> {
    let file = syn::parse_file(text)?;
    let mut finder = Finder {
        text,
        function: String::new(),
        places: Vec::new(),
    };
    finder.visit_file(&file);
    Ok(finder.places)
}

/// The file with the changes of `places` behind switches, and the bytes that each takes in it.
///
/// * `places` place and number of its switch
pub(crate) fn apply(text: &str, places: &[(u32, &Place)]) -> (String, Vec<(u32, Range<usize>)>) {
    let mut edits: Vec<(u32, &Place, &Edit)> = places
        .iter()
        .flat_map(|(number, place)| place.edits.iter().map(|edit| (*number, *place, edit)))
        .collect();
    edits.sort_by_key(|(number, place, edit)| {
        // What ends here comes before what begins, the inner end before the outer one, the outer beginning first.
        let (end, number) = (place.span.end, i64::from(*number));
        match edit.closes {
            true => (edit.at.start, 0, usize::MAX - place.span.start, -number),
            false => (edit.at.start, 1, usize::MAX - end, number),
        }
    });
    let mut out = String::new();
    let mut from = 0;
    let mut ranges: Vec<(u32, Range<usize>)> = Vec::new();
    for (number, place, edit) in edits {
        out.push_str(&text[from..edit.at.start]);
        let start = out.len();
        out.push_str(&edit.text.replace('#', &format!("{ON}({number})")));
        from = edit.at.end;
        match ranges.iter_mut().find(|(known, _)| *known == number) {
            Some((_, range)) => range.end = out.len(),
            None => ranges.push((number, start..out.len() + place.span.len())),
        }
    }
    out.push_str(&text[from..]);
    (out, ranges)
}

struct Finder<'a> {
    text: &'a str,
    function: String,
    places: Vec<Place>,
}

impl Finder<'_> {
    fn push(&mut self, span: Span, change: &str, edits: Vec<Edit>) {
        let span = span.byte_range();
        let quoted = one_line(&self.text[span.clone()]);
        self.places.push(Place {
            span,
            function: self.function.clone(),
            change: format!("{change}: `{quoted}`"),
            edits,
        });
    }

    fn wrap(&mut self, span: Span, change: &str, head: &str, tail: &str) {
        self.push(span, change, wrapped(&span.byte_range(), head, tail));
    }

    fn function(
        &mut self,
        signature: &syn::Signature,
        attrs: &[syn::Attribute],
        block: &syn::Block,
    ) {
        if signature.constness.is_some() || is_test(attrs) {
            return;
        }
        let outer = std::mem::replace(&mut self.function, signature.ident.to_string());
        self.visit_block(block);
        self.function = outer;
    }

    /// A condition that always and one that never holds.
    fn condition(&mut self, condition: &Expr) {
        if !has_let(condition) {
            self.wrap(condition.span(), "always", "(# || (", "))");
            self.wrap(condition.span(), "never", "(!# && (", "))");
        }
    }

    /// The operator of an expression, and what may take its place; none for `&&`, `||` and assignments.
    fn operator(&self, binary: &ExprBinary) -> (&str, Option<[&'static str; 2]>) {
        let operator = &self.text[binary.op.span().byte_range()];
        let known = OPERATORS.iter().find(|(known, _)| *known == operator);
        (operator, known.map(|(_, others)| *others))
    }

    fn binary(&mut self, binary: &ExprBinary) {
        let span = binary.span();
        if let BinOp::And(_) | BinOp::Or(_) = binary.op {
            let (head, word) = match binary.op {
                BinOp::And(_) => ("(# || (", "drop operand of &&"),
                _ => ("(!# && (", "drop operand of ||"),
            };
            for operand in [&binary.left, &binary.right] {
                if !has_let(operand) {
                    self.wrap(operand.span(), word, head, "))");
                }
            }
            return;
        }
        // Of the two changes of a comparison, one by its place: the boundary or the opposite.
        let (from, Some(others)) = self.operator(binary) else {
            return;
        };
        let to = others[span.byte_range().start % 2];
        let change = format!("{from} to {to}");
        let mut edits = wrapped(
            &span.byte_range(),
            "(match (",
            &format!(") {{ (x, y) => if # {{ x {to} y }} else {{ x {from} y }} }})"),
        );
        edits.push(Edit::new(binary.op.span().byte_range(), ",", false));
        self.push(span, &change, edits);
    }

    fn literal(&mut self, literal: &syn::ExprLit) {
        let text = &self.text[literal.span().byte_range()];
        let other = match &literal.lit {
            Lit::Bool(value) => (!value.value).to_string(),
            Lit::Int(value) => match value.base10_parse::<u64>() {
                Ok(number) => format!("{}{}", number.wrapping_add(1), value.suffix()),
                Err(_) => return,
            },
            Lit::Float(value) => match value.base10_parse::<f64>() {
                Ok(0.0) => format!("1.0{}", value.suffix()),
                Ok(number) => format!("{:e}{}", 2.0 * number, value.suffix()),
                Err(_) => return,
            },
            _ => return,
        };
        let change = format!("{text} to {other}");
        let head = format!("(if # {{ {other} }} else {{ ");
        self.wrap(literal.span(), &change, &head, " })");
    }
}

fn has_let(expr: &Expr) -> bool {
    match expr {
        Expr::Let(_) => true,
        Expr::Binary(binary) => has_let(&binary.left) || has_let(&binary.right),
        _ => false,
    }
}

fn is_test(attrs: &[syn::Attribute]) -> bool {
    attrs.iter().any(|attribute| {
        let path = attribute.path();
        let of_test = |list: &syn::MetaList| list.tokens.to_string().contains("test");
        path.is_ident("test")
            || path.is_ident("cfg") && attribute.meta.require_list().is_ok_and(of_test)
    })
}

impl<'ast> Visit<'ast> for Finder<'_> {
    fn visit_item_fn(&mut self, item: &'ast syn::ItemFn) {
        self.function(&item.sig, &item.attrs, &item.block);
    }

    fn visit_impl_item_fn(&mut self, item: &'ast syn::ImplItemFn) {
        self.function(&item.sig, &item.attrs, &item.block);
    }

    fn visit_trait_item_fn(&mut self, item: &'ast syn::TraitItemFn) {
        if let Some(block) = &item.default {
            self.function(&item.sig, &item.attrs, block);
        }
    }

    fn visit_item_mod(&mut self, item: &'ast syn::ItemMod) {
        if !is_test(&item.attrs) {
            visit::visit_item_mod(self, item);
        }
    }

    // Constants, types, patterns and macros take no switch.
    fn visit_item_const(&mut self, _: &'ast syn::ItemConst) {}
    fn visit_item_static(&mut self, _: &'ast syn::ItemStatic) {}
    fn visit_impl_item_const(&mut self, _: &'ast syn::ImplItemConst) {}
    fn visit_trait_item_const(&mut self, _: &'ast syn::TraitItemConst) {}
    fn visit_item_enum(&mut self, _: &'ast syn::ItemEnum) {}
    fn visit_type(&mut self, _: &'ast syn::Type) {}
    fn visit_path(&mut self, _: &'ast syn::Path) {}
    fn visit_pat(&mut self, _: &'ast syn::Pat) {}
    fn visit_generic_argument(&mut self, _: &'ast syn::GenericArgument) {}
    fn visit_angle_bracketed_generic_arguments(
        &mut self,
        _: &'ast syn::AngleBracketedGenericArguments,
    ) {
    }
    fn visit_attribute(&mut self, _: &'ast syn::Attribute) {}
    fn visit_macro(&mut self, _: &'ast syn::Macro) {}
    fn visit_expr_const(&mut self, _: &'ast syn::ExprConst) {}

    fn visit_expr_repeat(&mut self, repeat: &'ast syn::ExprRepeat) {
        self.visit_expr(&repeat.expr);
    }

    fn visit_arm(&mut self, arm: &'ast syn::Arm) {
        if let Some((_, guard)) = &arm.guard {
            self.condition(guard);
        }
        visit::visit_arm(self, arm);
    }

    fn visit_stmt(&mut self, stmt: &'ast Stmt) {
        if let Stmt::Expr(expr, Some(_)) = stmt {
            let acts = match expr {
                Expr::MethodCall(_) | Expr::Call(_) | Expr::Assign(_) | Expr::Try(_) => true,
                // `+=` and its like.
                Expr::Binary(binary) => {
                    let (operator, others) = self.operator(binary);
                    operator.ends_with('=') && others.is_none()
                }
                _ => false,
            };
            if acts {
                self.wrap(stmt.span(), "delete", "if !# { ", " }");
            }
        }
        visit::visit_stmt(self, stmt);
    }

    fn visit_expr(&mut self, expr: &'ast Expr) {
        match expr {
            Expr::Binary(binary) => self.binary(binary),
            Expr::Lit(literal) => self.literal(literal),
            Expr::If(branch) => self.condition(&branch.cond),
            Expr::While(branch) => self.condition(&branch.cond),
            Expr::Unary(unary) => match unary.op {
                UnOp::Not(_) => self.wrap(expr.span(), "drop !", "(# ^ (", "))"),
                UnOp::Neg(_) if !matches!(*unary.expr, Expr::Lit(_)) => {
                    let tail = " { x => if # { -x } else { x } })";
                    self.wrap(expr.span(), "drop -", "(match ", tail);
                }
                _ => {}
            },
            Expr::Macro(call) if call.mac.path.is_ident("matches") => {
                self.wrap(expr.span(), "opposite", "(# ^ ", ")");
            }
            Expr::MethodCall(call) => {
                let name = call.method.to_string();
                let span = expr.span().byte_range();
                match name.as_str() {
                    "min" | "max" if call.args.len() == 1 => {
                        let other = if name == "min" { "max" } else { "min" };
                        let receiver = call.receiver.span().byte_range();
                        let args = call.args.span().byte_range();
                        let tail = format!(
                            ") {{ (x, y) => if # {{ x.{other}(y) }} else {{ x.{name}(y) }} }})"
                        );
                        let edits = vec![
                            Edit::new(span.start..span.start, "(match (", false),
                            Edit::new(receiver.end..args.start, ", ", false),
                            Edit::new(args.end..span.end, &tail, true),
                        ];
                        self.push(expr.span(), &format!("{name} to {other}"), edits);
                    }
                    "any" | "all" | "is_some" | "is_none" | "is_ok" | "is_err" | "is_empty"
                    | "contains" | "is_finite" | "is_some_and" => {
                        self.wrap(expr.span(), "opposite", "(# ^ ", ")");
                    }
                    _ => {}
                }
            }
            _ => {}
        }
        visit::visit_expr(self, expr);
    }
}
