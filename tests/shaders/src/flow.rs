//! Barriers in flow that may differ between the units of a cube.
//!
//! Every unit of a cube has to reach a barrier, or none. WGSL says so, but naga 30 does not check it. DirectX's older compiler
//! (FXC) does, and is stricter: it refuses a barrier in a branch or loop whose condition was read from shared memory or from a
//! writable buffer, unless another barrier stands between the read and the branch (error X4026, "consider adding a sync after
//! reading any values controlling shader execution"). CubeCL declares every buffer writable.
//!
//! The analysis walks a function's statements and keeps for each value whether it varies and whether it was read without a
//! barrier since. Loops are walked until nothing changes. It errs towards a finding.

use std::collections::BTreeSet;
use std::ops::{BitOr, BitOrAssign};

use naga::{
    AddressSpace, Binding, Block, BuiltIn, Expression, Function, GlobalVariable, Handle, LocalVariable, Module,
    ShaderStage, Statement, StorageAccess, TypeInner,
};

/// What a value, or the flow to a statement, may depend on.
#[derive(Clone, Copy, Default, PartialEq, Eq)]
struct Taint {
    /// It may differ between the units of a cube.
    varies: bool,
    /// It was read from this memory, which units may write, and no barrier followed.
    unsettled: Option<Handle<GlobalVariable>>,
}

const UNIFORM: Taint = Taint { varies: false, unsettled: None };
const VARIES: Taint = Taint { varies: true, unsettled: None };

impl BitOr for Taint {
    type Output = Self;

    fn bitor(self, other: Self) -> Self {
        Self { varies: self.varies || other.varies, unsettled: self.unsettled.or(other.unsettled) }
    }
}

impl BitOrAssign for Taint {
    fn bitor_assign(&mut self, other: Self) {
        *self = *self | other;
    }
}

/// Taints of the values at a place of a function.
#[derive(Clone, PartialEq)]
struct Values {
    expressions: Vec<Taint>,
    variables: Vec<Taint>,
}

impl Values {
    fn join(&mut self, other: &Self) {
        self.expressions.iter_mut().zip(&other.expressions).for_each(|(own, other)| *own |= *other);
        self.variables.iter_mut().zip(&other.variables).for_each(|(own, other)| *own |= *other);
    }

    /// After a barrier, what was read is the same for all units that read it.
    fn settle(&mut self) {
        self.expressions.iter_mut().chain(&mut self.variables).for_each(|taint| taint.unsettled = None);
    }
}

/// The innermost loop around a statement.
struct Loop {
    /// The flow of the units that left the loop or an iteration of it, which no longer take part.
    flow: Taint,
    /// The values where units left.
    left: Option<Values>,
}

struct Walk<'a> {
    module: &'a Module,
    function: &'a Function,
    loops: Vec<Loop>,
    /// The flow of the units that returned.
    returned: Taint,
    faults: BTreeSet<String>,
}

/// Returns why barriers of a module's kernels are not reached by all units, or may not be.
pub fn barriers_at_fault(module: &Module) -> BTreeSet<String> {
    let mut faults = BTreeSet::new();
    for entry in module.entry_points.iter().filter(|entry| entry.stage == ShaderStage::Compute) {
        let function = &entry.function;
        let mut walk = Walk { module, function, loops: Vec::new(), returned: UNIFORM, faults: BTreeSet::new() };
        let mut values = Values {
            expressions: vec![UNIFORM; function.expressions.len()],
            variables: vec![UNIFORM; function.local_variables.len()],
        };
        // Arguments, constants and variables are in no statement.
        for (handle, _) in function.expressions.iter() {
            values.expressions[handle.index()] = walk.taint(handle, &values);
        }
        walk.block(&function.body, &mut values, UNIFORM);
        faults.append(&mut walk.faults);
    }
    faults
}

impl Walk<'_> {
    fn block(&mut self, block: &Block, values: &mut Values, flow: Taint) {
        for statement in block {
            let flow = flow | self.returned | self.loops.last().map_or(UNIFORM, |innermost| innermost.flow);
            self.statement(statement, values, flow);
        }
    }

    fn statement(&mut self, statement: &Statement, values: &mut Values, flow: Taint) {
        match statement {
            Statement::Emit(range) => {
                for handle in range.clone() {
                    values.expressions[handle.index()] = self.taint(handle, values);
                }
            }
            Statement::Block(block) => self.block(block, values, flow),
            Statement::If { condition, accept, reject } => {
                let flow = flow | values.expressions[condition.index()];
                let mut other = values.clone();
                self.block(accept, values, flow);
                self.block(reject, &mut other, flow);
                values.join(&other);
            }
            Statement::Switch { selector, cases } => {
                let flow = flow | values.expressions[selector.index()];
                let before = values.clone();
                for case in cases {
                    let mut own = before.clone();
                    self.block(&case.body, &mut own, flow);
                    values.join(&own);
                }
            }
            Statement::Loop { body, continuing, break_if } => self.repeat(body, continuing, *break_if, values, flow),
            Statement::Break | Statement::Continue => {
                // A break of a switch is taken for one of the loop around it.
                if let Some(innermost) = self.loops.last_mut() {
                    innermost.flow |= flow;
                    match &mut innermost.left {
                        Some(left) => left.join(values),
                        none => *none = Some(values.clone()),
                    }
                }
            }
            Statement::Return { .. } | Statement::Kill => self.returned |= flow,
            Statement::ControlBarrier(_) => {
                self.check(flow);
                values.settle();
            }
            Statement::WorkGroupUniformLoad { result, .. } => {
                self.check(flow);
                values.settle();
                values.expressions[result.index()] = UNIFORM;
            }
            Statement::Store { pointer, value } => {
                let at = values.expressions[pointer.index()];
                let stored = values.expressions[value.index()] | at | flow;
                let function = self.function;
                if let Expression::LocalVariable(variable) = function.expressions[*pointer] {
                    values.variables[variable.index()] = stored;
                } else if let Some(variable) = self.variable(*pointer) {
                    values.variables[variable.index()] |= stored;
                }
            }
            Statement::Atomic { result: Some(result), .. }
            | Statement::SubgroupBallot { result, .. }
            | Statement::SubgroupGather { result, .. }
            | Statement::SubgroupCollectiveOperation { result, .. } => values.expressions[result.index()] = VARIES,
            // CubeCL calls only functions of numbers.
            Statement::Call { arguments, result: Some(result), .. } => {
                let taints = arguments.iter().map(|argument| values.expressions[argument.index()]);
                values.expressions[result.index()] = taints.fold(UNIFORM, Taint::bitor);
            }
            _ => {}
        }
    }

    /// Walks a loop until its values and its flow stay the same.
    fn repeat(
        &mut self,
        body: &Block,
        continuing: &Block,
        break_if: Option<Handle<Expression>>,
        values: &mut Values,
        flow: Taint,
    ) {
        self.loops.push(Loop { flow: UNIFORM, left: None });
        loop {
            let (before, flow_before) = (values.clone(), self.flow_of_loop());
            let mut iteration = values.clone();
            self.block(body, &mut iteration, flow);
            // Units that went on to the next iteration are here again.
            if let Some(left) = self.loops.last().and_then(|innermost| innermost.left.clone()) {
                iteration.join(&left);
            }
            self.block(continuing, &mut iteration, flow);
            if let (Some(condition), Some(innermost)) = (break_if, self.loops.last_mut()) {
                innermost.flow |= flow | iteration.expressions[condition.index()];
            }
            values.join(&iteration);
            if *values == before && self.flow_of_loop() == flow_before {
                break;
            }
        }
        self.loops.pop();
    }

    fn flow_of_loop(&self) -> Taint {
        self.loops.last().map_or(UNIFORM, |innermost| innermost.flow)
    }

    fn check(&mut self, flow: Taint) {
        if flow.varies {
            self.faults.insert("a barrier in flow that varies between units".into());
        } else if let Some(memory) = flow.unsettled {
            let memory = match &self.module.global_variables[memory].binding {
                Some(buffer) => format!("buffer {}", buffer.binding),
                None => "shared memory".into(),
            };
            self.faults.insert(format!("a barrier in flow read from {memory}, and no barrier between (X4026)"));
        }
    }

    /// The taint of an expression from those of its operands.
    fn taint(&self, handle: Handle<Expression>, values: &Values) -> Taint {
        let of = |operand: &Handle<Expression>| values.expressions[operand.index()];
        let any = |operands: &[Handle<Expression>]| operands.iter().map(of).fold(UNIFORM, Taint::bitor);
        match &self.function.expressions[handle] {
            Expression::Literal(_)
            | Expression::Constant(_)
            | Expression::Override(_)
            | Expression::ZeroValue(_)
            | Expression::GlobalVariable(_)
            | Expression::LocalVariable(_)
            | Expression::ArrayLength(_) => UNIFORM,
            Expression::FunctionArgument(at) => self.argument(*at),
            Expression::Compose { components, .. } => any(components),
            Expression::Access { base, index } => any(&[*base, *index]),
            Expression::AccessIndex { base, index } => match self.function.expressions[*base] {
                Expression::FunctionArgument(at) => self.member(at, *index),
                _ => of(base),
            },
            Expression::Splat { value, .. } => of(value),
            Expression::Swizzle { vector, .. } => of(vector),
            Expression::Load { pointer } => of(pointer) | self.memory(*pointer, values),
            Expression::Unary { expr, .. } | Expression::As { expr, .. } => of(expr),
            Expression::Binary { left, right, .. } => any(&[*left, *right]),
            Expression::Select { condition, accept, reject } => any(&[*condition, *accept, *reject]),
            Expression::Relational { argument, .. } => of(argument),
            Expression::Math { arg, arg1, arg2, arg3, .. } => {
                [Some(*arg), *arg1, *arg2, *arg3].iter().flatten().map(of).fold(UNIFORM, Taint::bitor)
            }
            // Results of statements, which set them.
            Expression::AtomicResult { .. }
            | Expression::WorkGroupUniformLoadResult { .. }
            | Expression::SubgroupBallotResult
            | Expression::SubgroupOperationResult { .. }
            | Expression::CallResult(_) => of(&handle),
            _ => VARIES,
        }
    }

    /// The taint of what a pointer's memory holds.
    fn memory(&self, pointer: Handle<Expression>, values: &Values) -> Taint {
        if let Some(variable) = self.variable(pointer) {
            return values.variables[variable.index()];
        }
        match self.function.expressions[self.root(pointer)] {
            Expression::GlobalVariable(global) => match self.module.global_variables[global].space {
                AddressSpace::Uniform | AddressSpace::Immediate => UNIFORM,
                AddressSpace::Storage { access } if !access.contains(StorageAccess::STORE) => UNIFORM,
                AddressSpace::Storage { .. } | AddressSpace::WorkGroup => Taint { unsettled: Some(global), ..UNIFORM },
                _ => VARIES,
            },
            _ => VARIES,
        }
    }

    /// The local variable that a pointer points into.
    fn variable(&self, pointer: Handle<Expression>) -> Option<Handle<LocalVariable>> {
        match self.function.expressions[self.root(pointer)] {
            Expression::LocalVariable(variable) => Some(variable),
            _ => None,
        }
    }

    fn root(&self, mut pointer: Handle<Expression>) -> Handle<Expression> {
        while let Expression::Access { base, .. } | Expression::AccessIndex { base, .. } =
            self.function.expressions[pointer]
        {
            pointer = base;
        }
        pointer
    }

    fn argument(&self, at: u32) -> Taint {
        let argument = &self.function.arguments[at as usize];
        match (&argument.binding, &self.module.types[argument.ty].inner) {
            (Some(binding), _) => input(binding),
            (None, TypeInner::Struct { members, .. }) => {
                members.iter().filter_map(|member| member.binding.as_ref()).map(input).fold(UNIFORM, Taint::bitor)
            }
            _ => VARIES,
        }
    }

    fn member(&self, at: u32, index: u32) -> Taint {
        let argument = &self.function.arguments[at as usize];
        match &self.module.types[argument.ty].inner {
            TypeInner::Struct { members, .. } => members[index as usize].binding.as_ref().map_or(VARIES, input),
            _ => self.argument(at),
        }
    }
}

fn input(binding: &Binding) -> Taint {
    match binding {
        Binding::BuiltIn(
            BuiltIn::WorkGroupId
            | BuiltIn::WorkGroupSize
            | BuiltIn::NumWorkGroups
            | BuiltIn::SubgroupSize
            | BuiltIn::NumSubgroups,
        ) => UNIFORM,
        _ => VARIES,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the faults of a kernel with this body.
    fn faults(body: &str) -> Vec<String> {
        let source = format!(
            "var<workgroup> table: array<u32, 64>;\n@group(0) @binding(0) var<storage, read> given: array<u32>;\n\
             @group(0) @binding(1) var<storage, read_write> kept: array<u32>;\n@compute @workgroup_size(64)\nfn \
             k(@builtin(local_invocation_index) unit: u32, @builtin(workgroup_id) cube: vec3<u32>) {{\n{body}\n}}"
        );
        let module = naga::front::wgsl::parse_str(&source).unwrap_or_else(|error| panic!("{error}"));
        barriers_at_fault(&module).into_iter().collect()
    }

    #[test]
    fn barriers_that_all_units_reach_are_sound() {
        for body in [
            "workgroupBarrier();",
            "if (cube.x > 3u) { workgroupBarrier(); }",
            "if (given[cube.x] > 3u) { workgroupBarrier(); }",
            "for (var i = 0u; i < given[cube.x]; i++) { table[unit] = i; workgroupBarrier(); }",
            "if (unit > 3u) { table[unit] = 1u; } workgroupBarrier();",
            "table[unit] = 1u; workgroupBarrier(); let x = table[0]; workgroupBarrier(); if (x > 1u) { workgroupBarrier(); }",
            "for (var i = 0u; i < 9u; i++) { workgroupBarrier(); let x = table[0]; workgroupBarrier(); if (x > 1u) { break; } }",
            "var n = unit; n = cube.x; if (n > 1u) { workgroupBarrier(); }",
        ] {
            assert_eq!(faults(body), Vec::<String>::new(), "{body}");
        }
    }

    #[test]
    fn barriers_in_flow_that_varies_are_found() {
        for body in [
            "if (unit > 3u) { workgroupBarrier(); }",
            "if (unit > 3u) { return; } workgroupBarrier();",
            "for (var i = 0u; i < unit; i++) { workgroupBarrier(); }",
            "loop { workgroupBarrier(); if (given[unit] > 3u) { break; } }",
            "var n = 0u; if (unit > 3u) { n = 1u; } if (n > 0u) { workgroupBarrier(); }",
            "var n = 0u; loop { if (n > unit) { break; } n += 1u; } if (n > 3u) { workgroupBarrier(); }",
        ] {
            assert!(faults(body).iter().any(|fault| fault.contains("varies")), "{body}");
        }
    }

    #[test]
    fn barriers_behind_unsettled_reads_are_found() {
        for body in [
            "let x = table[0]; if (x > 1u) { workgroupBarrier(); }",
            "if (kept[cube.x] > 1u) { workgroupBarrier(); }",
            "for (var i = 0u; i < 9u; i++) { workgroupBarrier(); if (table[0] > 1u) { break; } }",
        ] {
            assert!(faults(body).iter().any(|fault| fault.contains("X4026")), "{body}");
        }
    }
}
